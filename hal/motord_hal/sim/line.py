# SPDX-License-Identifier: Apache-2.0
"""One line of a simulated robot: a pseudo-terminal whose bytes come when a UART would bring them.

A pty carries a frame in no time. Here a request ends when its bytes would have passed the wire, the
reply begins after the drive's turn-around and each of its bytes is there when the wire would have
brought it, in pieces of about a millisecond, as a UART's receive buffer hands them over.
Frames end and begin by silence: MODBUS over Serial Line V1.02, 2.5.1.1.
"""

from __future__ import annotations

import errno
import math
import os
import tty
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from motord_hal.drives.profile import Gap
from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    FrameError,
    character_bits,
    request_bytes,
    sealed,
    silent_interval_s,
)
from motord_hal.modbus.timing import drive_gap_s, line_gap_s
from motord_hal.ports import LineSpec
from motord_hal.sim.drive import SimulatedDrive
from motord_hal.sim.faults import FaultScript
from motord_hal.sim.slave import answer

PIECE_S = 0.001
TURNAROUND_PART = 0.5
"""Drives take half of the longest turn-around that their manual names."""
ABSENT_RETRY_S = 0.005
"""How often to look whether somebody has opened the port."""
GAP_TOLERANCE = 0.97
"""A silence this part of the due one is none too short: the clocks of both sides round."""


@dataclass(slots=True)
class LineCounters:
    frames: int = 0
    bad_crc: int = 0
    """Frames with a wrong check sum, torn ones and those that ran into each other."""
    unanswered: int = 0
    """Requests for units that are not on this line, have no power or are silenced."""
    replies: int = 0
    bytes_sent: int = 0
    gap_violations: int = 0
    plugged: int = 0


@dataclass(slots=True)
class _Reply:
    starts_s: float
    frame: bytes
    sent: int = 0


class SimulatedLine:
    """A pty master, half-duplex. `link` is the path that a robot file would name as its port."""

    def __init__(
        self,
        spec: LineSpec,
        drives: Mapping[int, SimulatedDrive],
        script: FaultScript,
        link: Path,
    ) -> None:
        self.spec = spec
        self.drives = drives
        self.link = link
        self.counters = LineCounters()
        self._script = script
        bits = character_bits(spec.parity, spec.stop_bits)
        self._character_s = bits / spec.baudrate
        self._silence_s = silent_interval_s(spec.baudrate, bits)
        self._piece_bytes = max(1, round(PIECE_S / self._character_s))
        self._fd: int | None = None
        self._absent_until_s = -math.inf
        self._quiet()

    def _quiet(self) -> None:
        self._request = bytearray()
        self._frame_ends_s = math.inf
        self._gap_s = math.inf
        self._wire_free_s = -math.inf
        self._replies: deque[_Reply] = deque()
        self._held: list[bytes] = []

    # ---------------------------------------------------------------------------------- plugging
    def plug(self) -> None:
        """A new pty, and the link to it. Does nothing while one is plugged. Raises OSError."""
        if self._fd is not None:
            return
        if self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(errno.EEXIST, "is in the way of a line's port", str(self.link))
        self._fd, slave_fd = os.openpty()
        os.set_blocking(self._fd, False)
        # A pty's modes are set from its master as well, so nothing keeps the other side open and a
        # client that goes away is seen.
        tty.setraw(self._fd)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(slave_fd))
        fresh.replace(self.link)
        os.close(slave_fd)
        self.counters.plugged += 1
        self._quiet()

    def pull(self) -> None:
        """The adapter is gone, with its device file: whoever has the port open gets a hang-up."""
        if self._fd is None:
            return
        os.close(self._fd)
        self._fd = None
        self.link.unlink(missing_ok=True)
        self._quiet()

    # ------------------------------------------------------------------------------- the poll loop
    def fileno_at(self, now_s: float) -> int | None:
        """What to wait for with select; None while nobody has the port open."""
        return None if now_s < self._absent_until_s else self._fd

    def due_s(self) -> float:
        """When `work` has to be called next, bytes or not."""
        due_s = self._frame_ends_s
        if self._replies:
            reply = self._replies[0]
            upto = min(reply.sent + self._piece_bytes, len(reply.frame))
            due_s = min(due_s, reply.starts_s + upto * self._character_s)
        if self._absent_until_s > -math.inf:
            due_s = min(due_s, self._absent_until_s)
        return due_s

    def work(self, now_s: float) -> None:
        """Take in what has come, do what is due."""
        if self._fd is None:
            return
        if now_s >= self._absent_until_s:
            self._absent_until_s = -math.inf
            self._take_in(self._fd, now_s)
        if now_s >= self._frame_ends_s:
            self._end_frame(now_s)
        self._send(now_s)

    def _take_in(self, fd: int, now_s: float) -> None:
        try:
            data = os.read(fd, 4096)
        except BlockingIOError:
            return
        except OSError:  # nobody has the other side open
            self._quiet()
            self._absent_until_s = now_s + ABSENT_RETRY_S
            return
        if not self._request:
            self._gap_s = now_s - self._wire_free_s
        self._request += data
        self._wire_free_s = max(self._wire_free_s, now_s) + len(data) * self._character_s
        self._frame_ends_s = self._wire_free_s + (0.0 if self._whole() else self._silence_s)

    def _whole(self) -> bool:
        frame = bytes(self._request)
        try:
            return request_bytes(frame) == len(frame) and sealed(frame)
        except FrameError:
            return False

    def _end_frame(self, now_s: float) -> None:
        frame, ended_s = bytes(self._request), self._wire_free_s
        drive = self.drives.get(frame[0])
        too_early = self._gap_s < GAP_TOLERANCE * self._due_gap_s(drive)
        self._request.clear()
        self._frame_ends_s = math.inf
        self.counters.frames += 1
        self.counters.gap_violations += too_early
        for held in self._held:
            self._queue(held, now_s)
        self._held.clear()
        if not sealed(frame):
            self.counters.bad_crc += 1
            return
        if drive is not None:
            drive.stats.gap_violations += too_early
        self._answer(frame, ended_s, now_s)

    def _due_gap_s(self, drive: SimulatedDrive | None) -> float:
        """The drive's own word, else the robot file's, else the standard's."""
        if drive is None or (drive.profile.gap is Gap.SPEC and drive.profile.gap_s is None):
            return line_gap_s(self.spec)
        return drive_gap_s(drive.profile, self.spec)

    def _answer(self, frame: bytes, ended_s: float, now_s: float) -> None:
        hearing = {
            unit: drive
            for unit, drive in self.drives.items()
            if frame[0] in (BROADCAST_UNIT, unit) and not self._script.silent(unit, now_s)
        }
        reply = answer(frame, hearing, now_s)
        if reply is None:
            self.counters.unanswered += frame[0] != BROADCAST_UNIT
            return
        spoiled = self._script.spoil(reply.frame, now_s)
        if spoiled.held:
            self._held.append(spoiled.frame)
        elif spoiled.frame:
            turnaround_s = TURNAROUND_PART * reply.drive.profile.turnaround_s
            self._queue(spoiled.frame, ended_s + turnaround_s + spoiled.delay_s)

    def _queue(self, frame: bytes, starts_s: float) -> None:
        if self._replies:
            last = self._replies[-1]
            starts_s = max(starts_s, last.starts_s + len(last.frame) * self._character_s)
        self._replies.append(_Reply(starts_s, frame))
        self.counters.replies += 1

    def _send(self, now_s: float) -> None:
        while self._replies and self._fd is not None:
            reply = self._replies[0]
            passed = (now_s - reply.starts_s) / self._character_s
            # half a thousandth of a character: what is due now must not wait for a rounding error
            upto = max(reply.sent, min(len(reply.frame), math.floor(passed + 0.0005)))
            self._put(self._fd, reply.frame[reply.sent : upto])
            reply.sent = upto
            if upto < len(reply.frame):
                return
            self._wire_free_s = max(self._wire_free_s, now_s)
            self._replies.popleft()

    def _put(self, fd: int, data: bytes) -> None:
        if data:
            try:
                self.counters.bytes_sent += os.write(fd, data)
            except BlockingIOError:
                return  # nobody reads: the bytes are lost, as in a UART's full buffer
