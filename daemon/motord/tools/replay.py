# SPDX-License-Identifier: Apache-2.0
"""Runs the journal of a recording through the core again, and compares the results bit for bit."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import zstandard

from motord.base.mcap_file import DamagedFile, attachments, messages
from motord.config.load import recorded
from motord.config.robot_file import ATTACHED_FILE
from motord.control.assembly import core_config
from motord.realtime.recorded import Damaged
from motord.realtime.replay import (
    CHECKPOINT_BYTES,
    LAYOUT_VERSION,
    RECORD_BYTES,
    Differing,
    ReplayedCore,
    tick_of,
    tick_of_state,
)

TOPIC = "/core_journal"
_FIXED = struct.Struct("<3I")
_LENGTH = struct.Struct("<I")
_CDR_HEADER_BYTES = 4
_CHECKPOINTS_KEPT = 8
_PART_BYTES_MAX = 64 << 20
_NO_ROBOT = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What the assembly of a configuration raises where the tables and drives of a recording do not fit
together."""
DIFFERENCES_MAX = 50
"""Number of differing ticks that are described; all of them are counted."""


class ReplayError(Exception):
    """The recording cannot be replayed; the text contains the reason and what to do."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A tick whose results differ from the recorded ones."""

    tick: int
    time_s: float
    """Time since the first tick that was compared."""
    fields: list[Differing]


@dataclass
class Outcome:
    """The result of a replay. At the start and after a gap, the ticks before the next recorded
    state are skipped."""

    ticks: int = 0
    seconds: float = 0.0
    checkpoints: int = 0
    """Number of recorded states that were compared with the core's whole state."""
    skipped: int = 0
    gaps: int = 0
    """Places where records are missing; the replay goes on from the next recorded state."""
    differing_ticks: int = 0
    first_difference: str | None = None
    differences: list[Difference] = field(default_factory=list)
    """The first DIFFERENCES_MAX ticks that differ."""

    @property
    def identical(self) -> bool:
        """Whether everything that could be compared is the same, bit for bit."""
        return self.ticks > 0 and self.differing_ticks == 0


Watch = Callable[[ReplayedCore], None]


def replay(path: Path, watch: Watch = lambda _: None) -> Outcome:
    """Step the core through the recording; call `watch` after each tick. Raise ReplayError or
    OSError if the recording cannot be read or replayed."""
    try:
        run: _Run | None = None
        for data in messages(path, TOPIC):
            checkpoints, records = _parsed(path, data)
            run = run or _Run(_core(path), watch)
            for checkpoint in checkpoints:
                run.note(checkpoint)
            for record in records:
                run.take(record)
    except DamagedFile as error:
        raise ReplayError(str(error)) from error
    except Damaged as error:
        raise ReplayError(f"{path}: a damaged message of {TOPIC}: {error}") from error
    if run is None or not run.outcome.ticks:
        raise ReplayError(f"{path}: no journal of the core in it: record with journal = true")
    return run.outcome


def _core(path: Path) -> ReplayedCore:
    """Return a core with the configuration of the recorded one, from the robot file in the
    recording. Raises ReplayError, DamagedFile, OSError."""
    attached = attachments(path)
    if ATTACHED_FILE not in attached:
        raise ReplayError(f"{path} has no robot file in it: an earlier motord recorded it")
    try:
        return ReplayedCore(core_config(*recorded(attached)))
    except _NO_ROBOT as error:
        raise ReplayError(f"{path}: a damaged robot file in it: {error}") from error


class _Run:
    def __init__(self, core: ReplayedCore, watch: Watch) -> None:
        self.outcome = Outcome()
        self._core = core
        self._watch = watch
        self._states: dict[int, bytes] = {}
        """Tick → the state that was recorded after it, for the newest recorded states."""

    def note(self, checkpoint: bytes) -> None:
        self._states[tick_of_state(checkpoint)] = checkpoint
        while len(self._states) > _CHECKPOINTS_KEPT:
            del self._states[next(iter(self._states))]

    def take(self, record: bytes) -> None:
        before = tick_of(record) - 1
        state = self._states.pop(before, None)
        if self._core.known and self._core.tick == before:
            if state is not None:
                self._compare(state)
        elif state is not None:
            self.outcome.gaps += self._core.known
            self._core.load(state)
        else:
            self.outcome.skipped += 1
            return
        self._step(record)

    def _step(self, record: bytes) -> None:
        began_ns = self._core.now_ns()
        differs = self._core.step(record)
        outcome = self.outcome
        if outcome.ticks > 0 and self._core.now_ns() > began_ns:
            outcome.seconds += (self._core.now_ns() - began_ns) * 1e-9
        outcome.ticks += 1
        if differs:
            self._differ(differs)
        self._watch(self._core)

    def _compare(self, state: bytes) -> None:
        self.outcome.checkpoints += 1
        if not self._core.is_at(state):
            self._differ([Differing("the core's state")])
            self._core.load(state)

    def _differ(self, fields: list[Differing]) -> None:
        outcome, tick = self.outcome, self._core.tick
        outcome.differing_ticks += 1
        if outcome.first_difference is None:
            what = ", ".join(differing.field for differing in fields)
            outcome.first_difference = f"tick {tick}: {what}"
        if len(outcome.differences) < DIFFERENCES_MAX:
            outcome.differences.append(Difference(tick, outcome.seconds, fields))


def _parsed(path: Path, data: bytes) -> tuple[list[bytes], list[bytes]]:
    """Return the states and records of a message."""
    try:
        layout = _FIXED.unpack_from(data, _CDR_HEADER_BYTES)
        if layout != (LAYOUT_VERSION, RECORD_BYTES, CHECKPOINT_BYTES):
            raise ReplayError(
                f"{path} was recorded by another version of motord: replay it with that"
            )
        at = _CDR_HEADER_BYTES + _FIXED.size
        states, at = _part(data, at)
        records, _ = _part(data, at + -at % 4)
        if len(states) % CHECKPOINT_BYTES or len(records) % RECORD_BYTES:
            raise ValueError("a part of a record")
    except (struct.error, ValueError, zstandard.ZstdError) as error:
        raise ReplayError(f"{path}: a damaged message of {TOPIC}: {error}") from error
    return _cut(states, CHECKPOINT_BYTES), _cut(records, RECORD_BYTES)


def _part(data: bytes, at: int) -> tuple[bytes, int]:
    length = _LENGTH.unpack_from(data, at)[0]
    at += _LENGTH.size
    packed = data[at : at + length]
    if len(packed) != length:
        raise ValueError("it ends early")
    if zstandard.frame_content_size(packed) > _PART_BYTES_MAX:  # the decompressor believes it
        raise ValueError("it is too long")
    unpacked = zstandard.ZstdDecompressor().decompress(packed, max_output_size=_PART_BYTES_MAX)
    return unpacked, at + length


def _cut(data: bytes, size: int) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]
