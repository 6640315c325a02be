# SPDX-License-Identifier: Apache-2.0
"""[dbc] of a drive profile: identifiers, places, scales and units from a DBC file, written out into
the frames and signals that name them. What the profile gives, too, must agree with the file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from motord.config.drives.can_tables import CanFrame, CanSignal, DbcFile
from motord.config.drives.problems import Problems
from motord.config.drives.tables import DriveFile
from motord.config.problems import ConfigError, Problem
from motord.config.reading import Places
from motord_hal.base import bounded
from motord_hal.base.nearest import did_you_mean

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal as DbcSignal

_ENCODING = "cp1252"
"""Encoding of DBC files: that of the tools which made the format."""
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
"""Keys in which a profile may differ from the file."""


def with_dbc(
    data: dict[str, Any], profile: DriveFile, path: Path, places: Places
) -> dict[str, Any]:
    """Return the profile's tables with all that its DBC file has about them; without [dbc]
    unchanged. Raises ConfigError with every problem that the two have with each other."""
    if profile.dbc is None:
        return data
    reader = _Reader(path.parent / profile.dbc.file, profile.dbc)
    if reader.loaded:
        can = profile.can
        node = profile.dbc.node
        node = (can.node if can else 0) if node is None else node
        shift = can.node_shift if can else 0
        frames = {
            name: reader.frame(name, frame, data["frame"][name], node, shift)
            for name, frame in profile.frames.items()
        }
        signals = {
            name: reader.signal(name, signal, data["signal"][name])
            for name, signal in profile.signals.items()
        }
        reader.check_whole()
        reserved = {**reader.reserved(node, shift), **data.get("reserved", {})}
        data = {**data, "frame": frames, "signal": signals, "reserved": reserved}
    if problems := [*reader.of_file, *places.sorted(reader.problems.found, warnings=False)]:
        raise ConfigError(problems)
    return data


class _Reader:
    """Reader of one DBC file, for what the profile names in it."""

    def __init__(self, file: Path, dbc: DbcFile) -> None:
        self.problems = Problems()
        """Problems of the profile."""
        self.of_file: list[Problem] = []
        self._file, self._drive = file, dbc.drive
        self._lines: list[str] = []
        self._messages = self._load()
        self._named: dict[str, Message] = {}
        """Frame of the profile → message of the file."""
        self._mapped: set[tuple[str, str]] = set()
        """Pairs of a frame and a signal of the DBC file that the profile has."""

    @property
    def loaded(self) -> bool:
        """Whether there is a file to compare the profile with."""
        return not self.of_file and not self.problems.found

    # ------------------------------------------------------------------------------------ the file
    def _load(self) -> dict[str, Message]:
        import cantools  # imported here, as only a robot with such a drive needs it
        from cantools.database.can import Database

        try:
            text = bounded.read(self._file, bounded.DESCRIPTION_BYTES_MAX).decode(
                _ENCODING, errors="replace"
            )
        except OSError as error:
            self.problems.add("dbc.file", f"{self._file}: cannot be read: {error.strerror}")
            return {}
        self._lines = text.splitlines()
        try:
            found = cantools.database.load_string(text, database_format="dbc", strict=False)
        except cantools.errors.Error as error:
            line = re.search(r"line (\d+)", str(error))
            self._complain(int(line.group(1)) if line else 1, "dbc", str(error))
            return {}
        assert isinstance(found, Database)  # by database_format
        names = [node.name for node in found.nodes]
        if self._drive not in names:
            hint = did_you_mean(self._drive, names) or f"; it has {', '.join(names) or 'none'}"
            self.problems.add("dbc.drive", f'"{self._drive}" is not a node of {self._file}{hint}')
        return {message.name: message for message in found.messages}

    def _complain(self, line: int, what: str, problem: str) -> None:
        self.of_file.append(Problem(str(self._file), line, what, problem))

    def _line_of(self, message: str, signal: str = "") -> int:
        """Return the line of a message, or of a signal in it; 1: it was not found."""
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
    def frame(
        self, name: str, table: CanFrame, given: Mapping[str, Any], node: int, shift: int
    ) -> Mapping[str, Any]:
        """Return the frame's table: what is `given`, and what the file has."""
        if table.dbc is None:
            return given
        key = f"frame.{name}"
        message = self._messages.get(self._known(key, table.dbc, self._messages))
        if message is None or not self._is_simple(message):
            return given
        self._named[name] = message
        shift = shift if table.node_shift is None else table.node_shift
        base = message.frame_id - (node << shift) * table.addressed
        if base < 0:
            problem = f"{message.frame_id:#x} of {message.name} is too small for node {node}"
            self.problems.add(f"{key}.dbc", f"{problem}: see node and node_shift")
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
        return self._agreed(key, given, found)

    def reserved(self, node: int, shift: int) -> dict[str, Mapping[str, Any]]:
        """Return the tables of the drive's messages that no frame names."""
        named = [message.name for message in self._named.values()]
        found: dict[str, Mapping[str, Any]] = {}
        for message in self._messages.values():
            by_drive = self._drive in message.senders
            if message.name in named or not (by_drive or self._drive in message.receivers):
                continue
            base = message.frame_id - (node << shift)
            found[f"dbc_{re.sub(r'[^a-z0-9_]', '_', message.name.lower())}"] = {
                "id": base if base >= 0 else message.frame_id,
                "addressed": base >= 0,
                "extended": message.is_extended_frame,
                "sender": "drive" if by_drive else "motord",
                "source": f"{self._file.name}, {message.name}",
            }
        return found

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

    def _known(self, key: str, name: str, known: Iterable[str]) -> str:
        """Return the name; add a problem if it is unknown."""
        known = list(known)
        if name not in known:
            hint = did_you_mean(name, known) or f"; there are {', '.join(known) or 'none'}"
            self.problems.add(f"{key}.dbc", f'"{name}" is not in {self._file}{hint}')
        return name

    # --------------------------------------------------------------------------------- the signals
    def signal(self, name: str, table: CanSignal, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the signal's table: what is `given`, and what the file has."""
        if table.dbc is None:
            return given
        key, frame = f"signal.{name}", table.frame
        message = self._named.get(frame)
        if message is None:
            if self.loaded:
                self.problems.add(f"{key}.frame", f'"{frame}" is not a frame of the DBC file')
            return given
        signals = {one.name: one for one in message.signals}
        signal = signals.get(self._known(key, table.dbc, signals))
        if signal is None or not self._is_sayable(message, signal):
            return given
        self._mapped.add((frame, signal.name))
        unit, factor = self._unit(key, given, signal)
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
            found |= self._limits(key, given, signal, factor)
            if start and "default" not in given:  # not taken over: it might make the motor run
                problem = f"is missing: {signal.name} starts with {start} in {self._file.name},"
                problem = f"{problem} motord would send 0 until it is written"
                self.problems.add(f"{key}.default", problem)
        return self._agreed(key, given, found)

    def _is_sayable(self, message: Message, signal: DbcSignal) -> bool:
        problem = ""
        if signal.length > _BITS_MAX or (signal.is_float and signal.length != _BITS_MAX):
            problem = f"{signal.length} bits: motord reads whole numbers of up to 32, and floats"
            problem += " of 32"
        elif not (math.isfinite(signal.scale) and math.isfinite(signal.offset) and signal.scale):
            problem = f"a scale of {signal.scale} and an offset of {signal.offset} give no value"
        if problem:
            line = self._line_of(message.name, signal.name)
            self._complain(line, f"{message.name}.{signal.name}", problem)
        return not problem

    def _unit(self, key: str, given: Mapping[str, Any], signal: DbcSignal) -> tuple[str, float]:
        """Return the unit as a profile names it, and the factor to it. The profile's unit counts if
        the file's is missing or unknown; a file does not distinguish electrical turns from
        turns."""
        text = (signal.unit or "").replace("\u00c2", "").strip()  # a degree sign that was UTF-8
        known = _UNITS.get(text.lower())
        wanted: str | None = given.get("unit")
        if wanted is None:
            if known is None:
                self.problems.add(
                    f"{key}.unit", f'is missing: "{text}" of {signal.name} is unknown here'
                )
            return known or ("", 1.0)
        if known is None or not text:
            return wanted, 1.0
        if wanted != known[0] and (wanted, known[0]) != ("erpm", "rpm"):
            self.problems.add(
                f"{key}.unit", f'"{wanted}" is not "{text}", as {self._file.name} has it'
            )
        return wanted, known[1]

    def _limits(
        self, key: str, given: Mapping[str, Any], signal: DbcSignal, factor: float
    ) -> dict[str, object]:
        """Return the limits of what motord may send. The profile may be narrower than the file."""
        found: dict[str, object] = {}
        ends = (("minimum", signal.minimum, 1), ("maximum", signal.maximum, -1))
        for end, limit, inward in ends:
            if limit is None or not math.isfinite(limit):
                continue
            found[end] = limit * factor
            own = given.get(end)
            if own is not None and (own - limit * factor) * inward < 0:
                problem = f"{own:g} is beyond the {limit * factor:g} of the DBC file"
                self.problems.add(f"{key}.{end}", problem)
        return found

    # ----------------------------------------------------------------------------- what both say
    def _agreed(
        self, key: str, given: Mapping[str, Any], found: Mapping[str, object]
    ) -> dict[str, Any]:
        """Return both together; add a problem if they differ in a value."""
        for part, value in found.items():
            own = given.get(part, value)
            if part not in _MAY_DIFFER and not _same(own, value):
                problem = f"{own!r} is not {value!r}, as {self._file.name} has it"
                self.problems.add(f"{key}.{part}", problem)
        return {**found, **given}

    def check_whole(self) -> None:
        """Check that the profile has all signals of a message that motord sends: else 0 would be
        sent."""
        for name, message in self._named.items():
            if self._drive in message.senders:
                continue
            for signal in message.signals:
                if (name, signal.name) not in self._mapped:
                    problem = f"{signal.name} of {message.name} has no [signal]: 0 would be sent"
                    self.problems.add(f"frame.{name}.dbc", problem)


def _type_of(signal: DbcSignal) -> str:
    if signal.is_float:
        return "f32"
    bits = next(bits for bits in (8, 16, 32) if signal.length <= bits)
    return f"{'i' if signal.is_signed else 'u'}{bits}"


def _same(one: object, other: object) -> bool:
    if isinstance(one, float | int) and isinstance(other, float | int):
        return math.isclose(one, other, rel_tol=1e-9)
    return one == other
