# SPDX-License-Identifier: Apache-2.0
"""The C core without loop and lines: it is stepped with recorded input, and its results are
compared with the recorded ones, bit for bit."""

from __future__ import annotations

import math
import mmap
import os
from dataclasses import dataclass
from typing import Any, Self

from _motord_rt import ffi, lib

from motord.api.page_file import PageFile
from motord.api.snapshot import Snapshot
from motord.api.state_page import decode
from motord.realtime.raw_config import raw_config
from motord.realtime.recorded import checked_input, checked_state
from motord.realtime.types import CoreConfig

LAYOUT_VERSION: int = lib.JOURNAL_LAYOUT_VERSION
RECORD_BYTES: int = ffi.sizeof("journal_record")
CHECKPOINT_BYTES: int = ffi.sizeof("core_state")


@dataclass(frozen=True, slots=True)
class Differing:
    """A value that differs from the recorded one."""

    field: str
    recorded: float | None = None
    """Recorded value, with the unit in the field's name; None: there is no finite number."""
    replayed: float | None = None


class ReplayedCore:
    """A core that you set to a recorded state and step with recorded input. Both are checked
    first (recorded.py)."""

    def __init__(self, config: CoreConfig) -> None:
        """`config`: the configuration of the recorded core. Raises ConfigRefused."""
        self._state = ffi.new("core_state *")
        lib.core_init(self._state, raw_config(config))
        self._initial = bytes(ffi.buffer(self._state))
        self._record = ffi.new("journal_record *")
        self._out = ffi.new("setpoints *")
        self._snapshot = ffi.new("robot_state *")
        self.known = False
        """True once the core has been set to a state."""

    def load(self, checkpoint: bytes) -> None:
        """Set the core to a recorded state. Raise Damaged for one that no core with this
        configuration has, ValueError for one of another size."""
        if len(checkpoint) != CHECKPOINT_BYTES:
            raise ValueError(f"a state of {len(checkpoint)} bytes, not {CHECKPOINT_BYTES}")
        checked_state(self._initial, checkpoint)
        ffi.memmove(self._state, checkpoint, CHECKPOINT_BYTES)
        self.known = True

    @property
    def tick(self) -> int:
        """Number of the last step's tick."""
        tick: int = self._state.tick
        return tick

    def is_at(self, checkpoint: bytes) -> bool:
        """Whether the core's state is equal to a recorded state, bit for bit."""
        return bytes(ffi.buffer(self._state)) == checkpoint

    def step(self, record: bytes) -> list[Differing]:
        """Step the core by one tick; return the values that differ from the recorded ones. Raise
        Damaged for input that the core cannot get, ValueError for a record of another size."""
        if len(record) != RECORD_BYTES:
            raise ValueError(f"a record of {len(record)} bytes, not {RECORD_BYTES}")
        checked_input(record)
        raw = self._record
        ffi.memmove(raw, record, RECORD_BYTES)
        lib.core_step(self._state, ffi.addressof(raw, "input"), raw.dt_s, self._out, self._snapshot)
        was = ffi.addressof(raw, "out")
        differs: list[Differing] = []
        if bytes(ffi.buffer(self._out)) != bytes(ffi.buffer(was)):
            differs = _differences(self._out, was)
        if not differs and lib.journal_digest(self._snapshot) != raw.digest:
            differs = [Differing("the snapshot")]
        return differs

    def now_ns(self) -> int:
        """Return the recorded time of the last step."""
        now_ns: int = self._record.input.now_ns
        return now_ns

    def snapshot(self) -> Snapshot:
        """Return the snapshot after the last step."""
        return decode(bytes(ffi.buffer(self._snapshot)))

    def show(self, page: ReplayPage, shift_ns: int) -> None:
        """Write the snapshot after the last step to a state page, with `shift_ns` added to its
        stamps."""
        raw = self._snapshot
        raw.stamp_ns += shift_ns
        raw.odometry_stamp_ns += shift_ns if raw.odometry_stamp_ns > 0 else 0
        page.write(raw)


def tick_of(record: bytes) -> int:
    """Return the number of the core's tick in which a record was made."""
    return int.from_bytes(record[:8], "little")


def tick_of_state(checkpoint: bytes) -> int:
    """Return the number of the core's tick after which a state was recorded."""
    raw = ffi.new("core_state *")
    ffi.memmove(raw, checkpoint, CHECKPOINT_BYTES)
    tick: int = raw.tick
    return tick


def _differences(now: Any, was: Any) -> list[Differing]:
    names = ["stamp_ns", "tick", "enabled", "joint_count"]
    pairs = [(name, getattr(was, name), getattr(now, name)) for name in names]
    for number in range(min(was.joint_count, lib.JOINTS_MAX)):
        pairs += [
            (
                f"joint[{number}].{name}",
                getattr(was.joint[number], name),
                getattr(now.joint[number], name),
            )
            for name in ("velocity_rad_s", "duty", "torque_n_m")
        ]
        pairs += [
            (
                f"joint[{number}].positioned",
                *(one.positioned >> number & 1 for one in (was, now)),
            ),
            (f"joint[{number}].position_rad", was.position_rad[number], now.position_rad[number]),
        ]
    found = [
        Differing(name, _finite(old), _finite(new))
        for name, old, new in pairs
        if old != new and not (math.isnan(old) and math.isnan(new))
    ]
    return found or [Differing("the bits of a set-point")]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


class ReplayPage:
    """A state page for a replay, in the same form as the page of a daemon. A context manager."""

    def __init__(self, robot: str) -> None:
        """Make the page. Raise PageInUse if a daemon of that name runs."""
        self._file = PageFile.open(robot)
        self.path = self._file.path
        os.truncate(self._file.fd, lib.PAGE_BYTES)
        self._memory = mmap.mmap(self._file.fd, lib.PAGE_BYTES)
        self._page = ffi.from_buffer(self._memory)
        lib.page_init(self._page)

    def write(self, raw: Any) -> None:
        """Publish a struct robot_state on the page."""
        lib.page_write(self._page, raw)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        ffi.release(self._page)
        self._memory.close()
        self._file.close()
