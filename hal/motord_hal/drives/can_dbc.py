# SPDX-License-Identifier: Apache-2.0
"""[dbc] of a drive profile: identifiers, places, scales and units from a DBC file, written out into
the frames and signals that name them. What the profile says too must agree with the file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError
from motord_hal.base.nearest import did_you_mean
from motord_hal.drives.toml_table import Problems, Table

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as DbcSignal

_ENCODING = "cp1252"
"""Of DBC files: what the tools write that made the format."""
_BITS_MAX = 32
_TURN_DEG, _TURN_RAD = 360.0, 2.0 * math.pi
# unit text, lower case → (unit of a profile, how many of those it is)
_UNITS = MappingProxyType(
    {
        **dict.fromkeys(("rpm", "1/min", "min-1", "r/min", "rev/min"), ("rpm", 1.0)),
        **dict.fromkeys(("turn/s", "turns/s", "rev/s", "rps", "r/s"), ("turn/s", 1.0)),
        **dict.fromkeys(("deg/s", "°/s"), ("turn/s", 1.0 / _TURN_DEG)),
        **dict.fromkeys(("turn", "turns", "rev"), ("turn", 1.0)),
        **dict.fromkeys(("deg", "°"), ("turn", 1.0 / _TURN_DEG)),
        **dict.fromkeys(("count", "counts", "cnt", "inc", "ticks"), ("count", 1.0)),
        **dict.fromkeys(("c", "degc", "deg c", "°c"), ("c", 1.0)),
        **dict.fromkeys(("%", "percent"), ("percent", 1.0)),
        "rad": ("turn", 1.0 / _TURN_RAD),
        "rad/s": ("rad/s", 1.0),
        "a": ("a", 1.0),
        "ma": ("a", 0.001),
        "v": ("v", 1.0),
        "mv": ("v", 0.001),
        "s": ("s", 1.0),
        "ms": ("ms", 1.0),
        "": ("", 1.0),
    }
)
_MAY_DIFFER = ("source", "period_s", "minimum", "maximum", "default")
"""What a profile may say otherwise than the file does."""


def with_dbc(values: dict[str, Any], path: Path, problems: Problems) -> dict[str, Any]:
    """The profile with all that its DBC file says of it; without [dbc] as it is. Raises
    ProfileError with every problem that the two have with each other."""
    if "dbc" not in values:
        return values
    root = Table("", values, problems)
    dbc, can = root.table("dbc"), root.table("can")
    file, drive = dbc.text("file"), dbc.text("drive")
    shift = can.integer("node_shift", 0, 24, 0)
    node = dbc.integer("node", 0, 255, can.integer("node", 0, 255))
    dbc.finish()
    if not problems.rows:
        reader = _Reader(path.parent / file, drive, problems)
        whole = {key: value for key, value in values.items() if key != "dbc"}
        whole["frame"] = reader.frames(root.table("frame"), node, shift)
        whole["signal"] = reader.signals(root.table("signal"))
        reader.check_whole()
    if problems.rows:
        raise ProfileError("\n".join(dict.fromkeys(problems.rows)))
    return whole


class _Reader:
    """One DBC file, and what of it the profile names."""

    def __init__(self, file: Path, drive: str, problems: Problems) -> None:
        self._file, self._drive, self._problems = file, drive, problems
        self._lines: list[str] = []
        self._messages = self._load()
        self._named: dict[str, Message] = {}
        """Frame of the profile → message."""
        self._mapped: set[tuple[str, str]] = set()
        """(frame, signal in the DBC file)."""

    # ------------------------------------------------------------------------------------ the file
    def _load(self) -> dict[str, Message]:
        import cantools  # only a robot that has such a drive pays for it
        from cantools.database.can import Database

        try:
            text = bounded.read(self._file, bounded.DESCRIPTION_BYTES_MAX).decode(
                _ENCODING, errors="replace"
            )
        except OSError as error:
            self._problems.add("dbc.file", f"{self._file}: cannot be read: {error.strerror}")
            return {}
        self._lines = text.splitlines()
        try:
            found = cantools.database.load_string(text, database_format="dbc", strict=False)
        except cantools.errors.Error as error:
            line = re.search(r"line (\d+)", str(error))
            self._complain(int(line.group(1)) if line else 1, "dbc", str(error))
            return {}
        assert isinstance(found, Database)  # the format says so
        names = [node.name for node in found.nodes]
        if self._drive not in names:
            hint = did_you_mean(self._drive, names) or f"; it has {', '.join(names) or 'none'}"
            self._problems.add("dbc.drive", f'"{self._drive}" is no node of {self._file}{hint}')
        return {message.name: message for message in found.messages}

    def _complain(self, line: int, what: str, problem: str) -> None:
        self._problems.rows.append(f"{self._file}:{line}: {what}: {problem}")

    def _line_of(self, message: str, signal: str = "") -> int:
        """Where the file says it."""
        inside = False
        for number, line in enumerate(self._lines, 1):
            words = line.replace(":", " ").split()
            if words[:1] == ["BO_"]:
                inside = words[2:3] == [message]
                if inside and not signal:
                    return number
            elif inside and words[:2] == ["SG_", signal]:
                return number
        return 1

    # ---------------------------------------------------------------------------------- the frames
    def frames(self, parent: Table, node: int, shift: int) -> dict[str, object]:
        return {
            name: self._frame(name, parent.table(name), node, shift)
            if parent.is_table(name)
            else None
            for name in parent
        }

    def _frame(self, name: str, table: Table, node: int, shift: int) -> dict[str, object]:
        given = table.without("dbc")
        if "dbc" not in table:
            return given
        message = self._messages.get(self._name(table, self._messages))
        if message is None or not self._is_simple(message):
            return given
        self._named[name] = message
        own = table.flag("addressed", default=True)
        base = message.frame_id - (node << table.integer("node_shift", 0, 24, shift)) * own
        if base < 0:
            problem = f"{message.frame_id:#x} of {message.name} is too small for node {node}"
            table.complain("dbc", f"{problem}: see node and node_shift")
        by_drive = self._drive in message.senders
        found: dict[str, object] = {
            "id": max(base, 0),
            "bytes": message.length,
            "extended": message.is_extended_frame,
            "fd": message.is_fd or message.length > 8,
            "sender": "drive" if by_drive else "motord",
            "source": f"{self._file.name}, {message.name}",
        }
        if by_drive and message.cycle_time and "ask" not in given:
            found["period_s"] = message.cycle_time / 1000
        return self._agreed(table, given, found)

    def _is_simple(self, message: Message) -> bool:
        import cantools

        line = self._line_of(message.name)
        if any(one.is_multiplexer or one.multiplexer_ids for one in message.signals):
            problem = "is multiplexed: motord reads only signals that always stand in their places"
            self._complain(line, message.name, problem)
            return False
        try:
            message.refresh(strict=True)
        except cantools.errors.Error as error:
            self._complain(line, message.name, str(error))
            return False
        return True

    def _name(self, table: Table, known: Iterable[str]) -> str:
        """What the table names."""
        name, known = table.text("dbc"), list(known)
        if name and name not in known:
            hint = did_you_mean(name, known) or f"; there are {', '.join(known) or 'none'}"
            table.complain("dbc", f'"{name}" is not in {self._file}{hint}')
        return name

    # --------------------------------------------------------------------------------- the signals
    def signals(self, parent: Table) -> dict[str, object]:
        return {
            name: self._signal(parent.table(name)) if parent.is_table(name) else None
            for name in parent
        }

    def _signal(self, table: Table) -> dict[str, object]:
        given = table.without("dbc")
        if "dbc" not in table:
            return given
        frame = table.text("frame")
        message = self._named.get(frame)
        if message is None:
            if not self._problems.rows:
                table.complain("frame", f'"{frame}" is no frame of the DBC file')
            return given
        signals = {one.name: one for one in message.signals}
        signal = signals.get(self._name(table, signals))
        if signal is None or not self._is_sayable(message, signal):
            return given
        self._mapped.add((frame, signal.name))
        unit, factor = self._unit(table, signal)
        start_bit, big = signal.start, signal.byte_order == "big_endian"
        found: dict[str, object] = {
            "start_bit": 8 * (start_bit // 8) + 7 - start_bit % 8 if big else start_bit,
            "length": signal.length,
            "byte_order": "big" if big else "little",
            "type": _type_of(signal),
            "scale": signal.scale * factor,
            "offset": signal.offset * factor,
            "unit": unit,
            "source": f"{self._file.name}, {message.name}, {signal.name}",
        }
        by_drive, start = self._drive in message.senders, signal.raw_initial
        if by_drive and isinstance(start, int) and not signal.is_float:
            found["default"] = start
        if not by_drive:
            found |= self._limits(table, given, signal, factor)
            if start and "default" not in given:  # it might be the command that lets the motor run
                problem = f"is missing: {signal.name} starts with {start} in {self._file.name},"
                table.complain("default", f"{problem} motord would send 0 until it is written")
        return self._agreed(table, given, found)

    def _is_sayable(self, message: Message, signal: DbcSignal) -> bool:
        problem = ""
        if signal.length > _BITS_MAX or (signal.is_float and signal.length != _BITS_MAX):
            problem = f"{signal.length} bits: motord reads whole numbers of up to 32, and floats"
            problem += " of 32"
        elif not (math.isfinite(signal.scale) and math.isfinite(signal.offset) and signal.scale):
            problem = f"a scale of {signal.scale} and an offset of {signal.offset} say nothing"
        if problem:
            line = self._line_of(message.name, signal.name)
            self._complain(line, f"{message.name}.{signal.name}", problem)
        return not problem

    def _unit(self, table: Table, signal: DbcSignal) -> tuple[str, float]:
        """The unit in the words of a profile, and the factor to it. What the profile says holds
        where the file has none, or one that is unknown; electrical turns are turns to a file."""
        text = (signal.unit or "").replace("\u00c2", "").strip()  # a degree sign that was UTF-8
        known = _UNITS.get(text.lower())
        wanted = table.text("unit", "") if "unit" in table else None
        if wanted is None:
            if known is None:
                table.complain("unit", f'is missing: "{text}" of {signal.name} is unknown here')
            return known or ("", 1.0)
        if known is None or not text:
            return wanted, 1.0
        if wanted != known[0] and (wanted, known[0]) != ("erpm", "rpm"):
            table.complain("unit", f'"{wanted}" is not "{text}", as {self._file.name} has it')
        return wanted, known[1]

    def _limits(
        self, table: Table, given: Mapping[str, object], signal: DbcSignal, factor: float
    ) -> dict[str, object]:
        """What may be sent. The profile may be narrower than the file."""
        found: dict[str, object] = {}
        ends = (("minimum", signal.minimum, 1), ("maximum", signal.maximum, -1))
        for key, limit, inward in ends:
            if limit is None or not math.isfinite(limit):
                continue
            found[key] = limit * factor
            own = given.get(key)
            if isinstance(own, int | float) and (own - limit * factor) * inward < 0:
                table.complain(key, f"{own:g} is beyond the {limit * factor:g} of the DBC file")
        return found

    # ----------------------------------------------------------------------------- what both say
    def _agreed(
        self, table: Table, given: Mapping[str, object], found: Mapping[str, object]
    ) -> dict[str, object]:
        """Both together; what is said in both must be the same."""
        for key, value in found.items():
            own = given.get(key, value)
            if key not in _MAY_DIFFER and not _same(own, value):
                table.complain(key, f"{own!r} is not {value!r}, as {self._file.name} has it")
        return {**found, **given}

    def check_whole(self) -> None:
        """A message that motord sends is known in all its parts: else 0 would go out in some."""
        for name, message in self._named.items():
            if self._drive in message.senders:
                continue
            for signal in message.signals:
                if (name, signal.name) not in self._mapped:
                    problem = f"{signal.name} of {message.name} has no [signal]: 0 would be sent"
                    self._problems.add(f"frame.{name}.dbc", problem)


def _type_of(signal: DbcSignal) -> str:
    if signal.is_float:
        return "f32"
    bits = next(bits for bits in (8, 16, 32) if signal.length <= bits)
    return f"{'i' if signal.is_signed else 'u'}{bits}"


def _same(one: object, other: object) -> bool:
    if isinstance(one, float | int) and isinstance(other, float | int):
        return math.isclose(one, other, rel_tol=1e-9)
    return one == other
