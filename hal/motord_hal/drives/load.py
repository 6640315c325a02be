# SPDX-License-Identifier: Apache-2.0
"""The reader of drive profiles: a TOML file in, a DriveProfile or every problem at once out.

The format is explained in docs/drives/README.md. What a value alone can say is checked here; what
follows only from several of them together is checked in `check.py`.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError
from motord_hal.base.nearest import did_you_mean
from motord_hal.base.paths import config_dir
from motord_hal.drives.bridge import read_bridge
from motord_hal.drives.can_dbc import with_dbc
from motord_hal.drives.can_eds import with_eds
from motord_hal.drives.can_load import NODE_MAX, read_signals, read_table
from motord_hal.drives.can_objects import read_objects
from motord_hal.drives.check import check_profile
from motord_hal.drives.profile import (
    SI_UNITS,
    Channel,
    Direction,
    DriveProfile,
    Enabled,
    FaultBit,
    Gap,
    Register,
    RegisterType,
    Step,
    Watchdog,
)
from motord_hal.drives.toml_table import Problems, Table

SCHEMA = 1
PROTOCOLS = ("modbus-rtu", "ddsm", "can", "mcu-frame", "ascii", "roboclaw", "pwm")
CHANNELS_MAX = 8
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_CHANNEL_KEYS = (
    "velocity_setpoint",
    "duty_setpoint",
    "torque_setpoint",
    "position",
    "velocity",
    "current",
    "temperature",
    "fault",
)


def list_profiles(extra_dirs: Iterable[Path] = ()) -> dict[str, Path]:
    """Name → file of every profile; the extra folders outrank the shipped one."""
    found: dict[str, Path] = {}
    for folder in (*extra_dirs, config_dir() / "drives"):
        for path in sorted(Path(folder).glob("*.toml")):
            found.setdefault(path.stem, path)
    return dict(sorted(found.items()))


def is_file_name(name: str) -> bool:
    """Whether a drive is named by its file and not by the name of a shipped profile."""
    return "/" in name or name.endswith(".toml")


def find_profile(name: str, extra_dirs: Iterable[Path] = ()) -> DriveProfile:
    """The shipped profile of that name, or the file where `is_file_name` holds. Raises
    ProfileError."""
    if is_file_name(name):
        return load_profile(Path(name))
    profiles = list_profiles(extra_dirs)
    if name not in profiles:
        known = ", ".join(profiles)
        raise ProfileError(
            f'no drive profile "{name}"{did_you_mean(name, profiles)}; known: {known}'
        )
    return load_profile(profiles[name])


def load_profile(path: Path, counts_per_turn: int | None = None) -> DriveProfile:
    """Read and check one file. Raises one ProfileError with a `file:line: key: problem` row for
    each problem in it.

    `counts_per_turn` replaces that of the file: another encoder on the same drive. Registers in
    "count/s" are speeds by that number, so it has to be known when they are read.
    """
    try:
        text = bounded.read(path).decode()
        values = bounded.toml(text)
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ProfileError(f"{path}: is not UTF-8: {error.reason}") from error
    except tomllib.TOMLDecodeError as error:
        line = re.search(r"line (\d+)", str(error))
        number = line.group(1) if line else len(text.splitlines())
        raise ProfileError(f"{path}:{number}: toml: {error}") from error
    problems = Problems(path, text)
    values = with_eds(with_dbc(values, path, problems), path, problems)
    if counts_per_turn and isinstance(values.get("motor"), dict):
        values = {**values, "motor": {**values["motor"], "counts_per_turn": counts_per_turn}}
    profile = replace(
        _profile(Table("", values, problems), path), speed_in_counts=_has_speed_in_counts(values)
    )
    check_profile(profile, problems)
    if problems.rows:
        raise ProfileError("\n".join(dict.fromkeys(problems.rows)))
    return profile


def _has_speed_in_counts(values: dict[str, Any]) -> bool:
    registers = values.get("register")
    rows = registers.values() if isinstance(registers, dict) else ()
    return any(isinstance(row, dict) and row.get("unit") == "count/s" for row in rows)


def _profile(root: Table, path: Path) -> DriveProfile:
    root.integer("schema", SCHEMA, SCHEMA)
    motor = root.table("motor", required=False)
    steps = root.table("steps")
    protocol = root.text("protocol", choices=PROTOCOLS)
    counts_per_turn = motor.integer("counts_per_turn", 0, 1 << 30, 0)
    pole_pairs = motor.integer("pole_pairs", 0, 100, 0)
    if protocol == "can":
        wire = _on_can(root, pole_pairs)
    else:
        wire = _on_serial(root, protocol, pole_pairs, counts_per_turn)
    profile = DriveProfile(
        name=root.text("name"),
        title=root.text("title"),
        protocol=protocol,
        source=root.text("source"),
        path=path,
        **wire,
        counts_per_turn=counts_per_turn,
        counter_bits=motor.one_of("counter_bits", (0, 8, 15, 16, 24, 32), 0),
        channels=_channels(root.table("channel")),
        configure=_steps(steps, "configure"),
        arm=_steps(steps, "arm"),
        disarm=_steps(steps, "disarm"),
        quick_stop=_steps(steps, "quick_stop"),
        clear_fault=_steps(steps, "clear_fault"),
        enabled=_enabled(root),
        watchdog=_watchdog(root),
        watchdog_note=root.text("watchdog_note") if "watchdog_note" in root else "",
        faults=tuple(_fault(table) for table in root.tables("fault")),
        bus_voltage=root.text("bus_voltage") if "bus_voltage" in root else None,
        bridge=read_bridge(root) if "bridge" in root else None,
    )
    for table in (motor, steps, root):
        table.finish()
    return profile


def _on_serial(root: Table, protocol: str, pole_pairs: int, counts_per_turn: int) -> dict[str, Any]:
    """What the profile of a drive on a serial line says of the wire, and its registers."""
    serial = root.table("serial")
    # where the protocol leaves no choice, the file need not say it
    one, six = (None, None) if protocol in ("modbus-rtu", "roboclaw") else (1, 6)
    both = "read_write_function" in serial
    wire = {
        "registers": _registers(root.table("register"), pole_pairs, counts_per_turn),
        "baudrate": serial.integer("baudrate", 300, 4_000_000),
        "parity": serial.text("parity", choices=("none", "even", "odd")),
        "stop_bits": serial.one_of("stop_bits", (1, 2)),
        "unit": serial.integer("unit", 1, 247),
        "turnaround_s": serial.number("turnaround_s", 1e-5, 1.0, unit="s"),
        "gap": Gap(serial.text("gap", "spec", choices=[rule.value for rule in Gap]) or "spec"),
        "gap_s": serial.number("gap_s", 1e-5, 0.1, unit="s") if "gap_s" in serial else None,
        "max_registers": serial.integer("max_registers", 1, 123, one),
        "write_function": serial.one_of("write_function", (6, 16), six),
        "read_write_function": serial.one_of("read_write_function", (23,)) if both else None,
        "broadcast_stop": serial.flag("broadcast_stop", default=False),
    }
    serial.finish()
    return wire


def _on_can(root: Table, pole_pairs: int) -> dict[str, Any]:
    """The same of a drive on a CAN bus: its registers are signals."""
    can = root.table("can")
    table = read_table(can, root.table("frame"))
    signals = read_signals(root.table("signal"), table.frames, pole_pairs)
    if "object" in root:
        table, objects = read_objects(root.table("object"), table)
        signals |= objects
    wire = {
        "registers": signals,
        "can": table,
        "baudrate": can.integer("bitrate", 10_000, 1_000_000),
        "parity": "none",
        "stop_bits": 1,
        "unit": can.integer("node", 0, NODE_MAX),
        "turnaround_s": can.number("turnaround_s", 1e-5, 1.0, unit="s"),
        "gap_s": None,
        "max_registers": 1,
        "write_function": 6,
    }
    can.finish()
    return wire


def _registers(parent: Table, pole_pairs: int, counts_per_turn: int) -> dict[str, Register]:
    found = {}
    for name in parent:
        if not _NAME.fullmatch(name):
            parent.complain(name, "a register's name is lower case letters, digits and _")
        found[name] = _register(name, parent.table(name), pole_pairs, counts_per_turn)
    if not found:
        parent.problems.add(parent.name, "there is no register")
    return found


def _register(name: str, table: Table, pole_pairs: int, counts_per_turn: int) -> Register:
    bound = 1e12
    unit = table.text("unit", "", choices=(*SI_UNITS, "hz", "count/s"))
    register = Register(
        name=name,
        address=table.integer("address", 0, 0xFFFF),
        type=RegisterType(
            table.text("type", choices=[t.value for t in RegisterType if t is not RegisterType.F32])
            or "u16"
        ),
        scale=table.number("scale", -bound, bound, 1.0),
        unit=unit,
        access=table.text("access", choices=("r", "w", "rw")),
        minimum=table.number("minimum", -bound, bound) if "minimum" in table else None,
        maximum=table.number("maximum", -bound, bound) if "maximum" in table else None,
        source=table.text("source"),
        mask=table.integer("mask", 1, 0xFFFF) if "mask" in table else None,
        default=table.integer("default", -(1 << 31), (1 << 32) - 1, 0),
    )
    table.finish()
    if unit == "hz":
        return _of_frequency(register, table, pole_pairs)
    if unit == "count/s":
        return _of_edges(register, table, counts_per_turn)
    return register


def _of_edges(register: Register, table: Table, counts_per_turn: int) -> Register:
    """The same register in rad/s of the shaft: 2π / edges of a turn."""
    if not counts_per_turn:
        table.complain("unit", '"count/s" needs motor.counts_per_turn to become a speed')
    return _in_unit(register, "rad/s", 2.0 * math.pi / max(counts_per_turn, 1))


def _of_frequency(register: Register, table: Table, pole_pairs: int) -> Register:
    """The same register in rpm of the field: 60 f / pole pairs (IEC 60034-1). An induction motor
    turns slower than its field by its slip."""
    if not pole_pairs:
        table.complain("unit", '"hz" needs motor.pole_pairs to become a speed')
    return _in_unit(register, "rpm", 60.0 / max(pole_pairs, 1))


def _in_unit(register: Register, unit: str, factor: float) -> Register:
    least, most = register.minimum, register.maximum
    return replace(
        register,
        unit=unit,
        scale=register.scale * factor,
        minimum=None if least is None else least * factor,
        maximum=None if most is None else most * factor,
    )


def _channels(parent: Table) -> dict[int, Channel]:
    found = {}
    for name in parent:
        if not name.isdecimal() or not 1 <= int(name) <= CHANNELS_MAX:
            parent.complain(name, f"a channel is a number, 1 to {CHANNELS_MAX}")
            continue
        table = parent.table(name)
        references = {key: table.text(key) if key in table else None for key in _CHANNEL_KEYS}
        direction = _direction(table.table("direction")) if "direction" in table else None
        together = _together(table.table("setpoint_with", required=False))
        found[int(name)] = Channel(**references, setpoint_with=together, direction=direction)
        table.finish()
    if sorted(found) != list(range(1, len(found) + 1)) or not found:
        parent.problems.add(
            parent.name, "channels are numbered 1, 2, ... and there is at least one"
        )
    return found


def _together(table: Table) -> tuple[tuple[str, int], ...]:
    """In the file's order."""
    together = tuple((name, table.integer(name, -(1 << 15), (1 << 16) - 1)) for name in table)
    table.finish()
    return together


def _direction(table: Table) -> Direction:
    direction = Direction(
        register=table.text("register"),
        forward=table.integer("forward", 0, 0xFFFF),
        reverse=table.integer("reverse", 0, 0xFFFF),
        rest=table.integer("rest", 0, 0xFFFF),
    )
    table.finish()
    return direction


def _steps(parent: Table, key: str) -> tuple[Step, ...]:
    steps = []
    for table in parent.tables(key):
        if ("write" in table) == ("wait" in table):
            problem = 'a step has either "write" or "wait"'
            table.problems.add(table.name, problem)
            continue
        steps.append(_write(table) if "write" in table else _wait(table))
        table.finish()
    return tuple(steps)


def _write(table: Table) -> Step:
    cycle = table.flag("cycle", default=False)
    return Step(
        register=table.text("write"),
        value=table.integer("value", -(1 << 31), (1 << 32) - 1, 0 if cycle else None),
        verify=table.flag("verify", default=True),
        plus_node=table.flag("plus_node", default=False),
        cycle=cycle,
    )


def _wait(table: Table) -> Step:
    return Step(
        register=table.text("wait"),
        mask=table.integer("mask", 1, 0xFFFFFFFF, 0xFFFFFFFF),
        equals=table.integer("equals", 0, 0xFFFFFFFF),
        within_s=table.number("within_s", 0.001, 10.0, unit="s"),
    )


def _enabled(root: Table) -> Enabled | None:
    if "enabled" not in root:
        return None
    table = root.table("enabled")
    enabled = Enabled(
        register=table.text("register"),
        mask=table.integer("mask", 1, 0xFFFFFFFF),
        equals=table.integer("equals", 0, 0xFFFFFFFF),
    )
    table.finish()
    return enabled


def _watchdog(root: Table) -> Watchdog | None:
    if "watchdog" not in root:
        return None
    table = root.table("watchdog")
    watchdog = Watchdog(
        register=table.text("register"),
        minimum_s=table.number("minimum_s", 0.001, 3600.0, unit="s"),
        maximum_s=table.number("maximum_s", 0.001, 3600.0, unit="s"),
        action=table.text("action"),
    )
    table.finish()
    return watchdog


def _fault(table: Table) -> FaultBit:
    if ("bit" in table) == ("code" in table):
        table.problems.add(table.name, 'a fault has either "bit" or "code"')
    fault = FaultBit(
        bit=table.integer("bit", 0, 31) if "bit" in table else None,
        code=table.integer("code", 1, 0xFFFF) if "code" in table else None,
        text=table.text("text"),
        severity=table.text("severity", choices=("fault", "warning")),
    )
    table.finish()
    return fault
