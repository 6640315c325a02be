# SPDX-License-Identifier: Apache-2.0
"""Builder of a DriveProfile, in SI units, from the tables of a drive profile."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from motord.config.drives.bridge import bridge_of
from motord.config.drives.can_build import can_signals, can_table
from motord.config.drives.objects import with_objects
from motord.config.drives.problems import Problems
from motord.config.drives.tables import (
    AnyStep,
    DriveFile,
    DriveWatchdog,
    EnabledWhen,
    FaultCode,
    HoldingRegister,
    IdentityRead,
    MotorChannel,
    ReverseRegister,
    TargetHandshake,
    WriteStep,
)
from motord.config.sections.section import Section
from motord_hal.drives.profile import (
    Channel,
    Direction,
    DriveProfile,
    Enabled,
    FaultBit,
    Gap,
    Handshake,
    Identity,
    Register,
    RegisterType,
    Step,
    Watchdog,
)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Part = TypeVar("Part", bound="DataclassInstance")
AnyOfRegister = DriveWatchdog | EnabledWhen | ReverseRegister | TargetHandshake
_SAYS_ITS_FRAMES = ("modbus-rtu", "roboclaw")
"""Protocols that leave a choice of how much a request carries and which function writes."""


def build(file: DriveFile, path: Path, problems: Problems) -> DriveProfile:
    """Return the profile. If the file lacks what its protocol needs, add a problem and use a
    harmless value."""
    return DriveProfile(
        name=file.name,
        title=file.title,
        protocol=file.protocol,
        source=file.source,
        path=path,
        **(_on_can if file.protocol == "can" else _on_serial)(file, problems),
        counts_per_turn=file.motor.counts_per_turn,
        counter_bits=file.motor.counter_bits,
        speed_in_counts=any(one.unit == "count/s" for one in file.registers.values()),
        channels=_channels(file.channels, problems),
        configure=_steps("configure", file.steps.configure, problems),
        arm=_steps("arm", file.steps.arm, problems),
        disarm=_steps("disarm", file.steps.disarm, problems),
        quick_stop=_steps("quick_stop", file.steps.quick_stop, problems),
        clear_fault=_steps("clear_fault", file.steps.clear_fault, problems),
        identity=tuple(_identity(table) for table in file.identity),
        enabled=_of_register(Enabled, file.enabled),
        power_off=_of_register(Enabled, file.power_off),
        absolute=file.absolute,
        homed=_of_register(Enabled, file.homed),
        watchdog=_of_register(Watchdog, file.watchdog),
        watchdog_note=file.watchdog_note or "",
        watchdog_fixed_s=file.watchdog_fixed_s or 0.0,
        unknown=tuple(file.unknown),
        faults=tuple(_fault(index, fault, problems) for index, fault in enumerate(file.faults)),
        bus_voltage=file.bus_voltage,
        bridge=bridge_of(file.bridge, problems) if file.bridge else None,
    )


def _on_serial(file: DriveFile, problems: Problems) -> dict[str, Any]:
    """Return the settings of a drive on a serial line, and its registers."""
    _check_absent(file, ("can", "frame", "signal", "object", "reserved"), problems)
    if not file.registers:
        problems.add("register", "there is no register")
    serial = file.serial
    if serial is None:
        problems.add("serial", "is missing")
    elif file.protocol in _SAYS_ITS_FRAMES:
        for part in ("max_registers", "write_function"):
            if getattr(serial, part) is None:
                problems.add(f"serial.{part}", "is missing")
    return {
        "registers": {
            name: _register(name, table, file, problems) for name, table in file.registers.items()
        },
        "baudrate": serial.baudrate if serial else 0,
        "parity": serial.parity if serial else "none",
        "stop_bits": serial.stop_bits if serial else 1,
        "unit": serial.unit if serial else 1,
        "turnaround_s": serial.turnaround_s if serial else 0.0,
        "gap": Gap(serial.gap) if serial else Gap.SPEC,
        "gap_s": serial and serial.gap_s,
        "max_registers": (serial and serial.max_registers) or 1,
        "write_function": (serial and serial.write_function) or 6,
        "read_write_function": serial and serial.read_write_function,
        "broadcast_stop": serial is not None and serial.broadcast_stop,
    }


def _on_can(file: DriveFile, problems: Problems) -> dict[str, Any]:
    """Return the settings of a drive on a CAN bus; its registers are signals."""
    _check_absent(file, ("serial", "register"), problems)
    can = file.can
    if can is None:
        problems.add("can", "is missing")
        return {
            "registers": {},
            "baudrate": 0,
            "parity": "none",
            "stop_bits": 1,
            "unit": 0,
            "turnaround_s": 0.0,
            "gap_s": None,
            "max_registers": 1,
            "write_function": 6,
        }
    table = can_table(can, file.frames, file.reserved, problems)
    signals = can_signals(file.signals, table.frames, file.motor.pole_pairs, problems)
    for name, entry in file.objects.items():
        if entry.type is None:
            problems.add(f"object.{name}.type", "is missing")
    if file.objects:
        table, objects = with_objects(table, file.objects)
        signals |= objects
    return {
        "registers": signals,
        "can": table,
        "baudrate": can.bitrate,
        "parity": "none",
        "stop_bits": 1,
        "unit": can.node,
        "turnaround_s": can.turnaround_s,
        "gap_s": None,
        "max_registers": 1,
        "write_function": 6,
    }


def _check_absent(file: DriveFile, keys: Sequence[str], problems: Problems) -> None:
    """Report tables of another kind of line: they would not be used."""
    given = {DriveFile.model_fields[name].alias or name for name in file.model_fields_set}
    for key in keys:
        if key in given:
            problems.add(key, f'is not for protocol "{file.protocol}"')


def _register(name: str, table: HoldingRegister, file: DriveFile, problems: Problems) -> Register:
    register = _made(Register, table, name=name, type=RegisterType(table.type))
    if table.unit == "hz":
        # rpm of the field: 60 f / pole pairs (IEC 60034-1); an induction motor turns slower than
        # its field by its slip
        pairs = file.motor.pole_pairs
        if not pairs:
            needs = '"hz" needs motor.pole_pairs to become a speed'
            problems.add(f"register.{name}.unit", needs)
        return _in_unit(register, "rpm", 60.0 / max(pairs, 1))
    if table.unit == "count/s":
        counts = file.motor.counts_per_turn
        if not counts:
            needs = '"count/s" needs motor.counts_per_turn to become a speed'
            problems.add(f"register.{name}.unit", needs)
        return _in_unit(register, "rad/s", 2.0 * math.pi / max(counts, 1))
    return register


def _in_unit(register: Register, unit: str, factor: float) -> Register:
    least, most = register.minimum, register.maximum
    return replace(
        register,
        unit=unit,
        scale=register.scale * factor,
        minimum=None if least is None else least * factor,
        maximum=None if most is None else most * factor,
    )


def _channels(tables: Mapping[str, MotorChannel], problems: Problems) -> dict[int, Channel]:
    found = {int(name): _channel(table) for name, table in tables.items()}
    if sorted(found) != list(range(1, len(found) + 1)) or not found:
        problems.add("channel", "channels are numbered 1, 2, ... and there is at least one")
    return found


def _channel(table: MotorChannel) -> Channel:
    return _made(
        Channel,
        table,
        setpoint_with=tuple(table.setpoint_with.items()),
        handshake=_of_register(Handshake, table.handshake),
        direction=_of_register(Direction, table.direction),
    )


def _made(kind: type[Part], table: Section, **own: Any) -> Part:
    """Make a part with the table's values by their names; `own`: values that the table has
    otherwise."""
    names = {field.name for field in fields(kind)} - own.keys()
    return kind(**{name: getattr(table, name) for name in names}, **own)


def _of_register(kind: type[Part], table: AnyOfRegister | None) -> Part | None:
    """Make a part as `_made`, if there is such a table."""
    return _made(kind, table, register=table.register_name) if table else None


def _steps(name: str, steps: Sequence[AnyStep], problems: Problems) -> tuple[Step, ...]:
    return tuple(
        _step(f"steps.{name}[{index}]", step, problems) for index, step in enumerate(steps)
    )


def _step(key: str, step: AnyStep, problems: Problems) -> Step:
    if not isinstance(step, WriteStep):
        return Step(register=step.wait, mask=step.mask, equals=step.equals, within_s=step.within_s)
    if step.value is None and not step.cycle:
        problems.add(f"{key}.value", "is missing")
    return Step(
        register=step.write,
        value=step.value or 0,
        verify=step.verify,
        plus_node=step.plus_node,
        cycle=step.cycle,
        if_different=step.if_different,
    )


def _identity(table: IdentityRead) -> Identity:
    others = tuple((int(value), name) for value, name in table.others.items())
    return Identity(
        register=table.register_name, mask=table.mask, values=tuple(table.values), others=others
    )


def _fault(index: int, table: FaultCode, problems: Problems) -> FaultBit:
    if (table.bit is None) == (table.code is None):
        problems.add(f"fault[{index}]", 'a fault has either "bit" or "code"')
    return _made(FaultBit, table)
