# SPDX-License-Identifier: Apache-2.0
"""A CAN bus of a simulated robot. Its drives send frames at their own times and follow those of the
master."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import can

from motord_hal.drives.can_profile import Frame, Sender
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.fieldbus.units import DriveKey
from motord_hal.sim.can.content import CanContent
from motord_hal.sim.can.port import CanPort
from motord_hal.sim.faults import FaultScript
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.wire import Clock

TURNAROUND_PART = 0.5
"""Part of the longest time in the profile that drives take to answer."""
BUS_OFF_IDENTIFIER = 0x40
"""CAN_ERR_BUSOFF of linux/can/error.h."""
TAKE_AT_ONCE = 256


@dataclass(slots=True)
class CanCounters:
    frames: int = 0
    """Number of frames from the master."""
    unanswered: int = 0
    """Number of those for absent nodes, or with an unknown frame."""
    sent: int = 0
    lost: int = 0
    """Number of frames that the CAN bus did not take, or a fault removed."""
    plugged: int = 0


class SimulatedCanLine:
    """Drives on a CAN bus that they share with the master."""

    def __init__(
        self,
        spec: LineSpec,
        drives: Mapping[DriveKey, SimulatedDrive],
        script: FaultScript,
        port: CanPort,
    ) -> None:
        self.spec = spec
        self.drives = drives
        self.port = port
        self.counters = CanCounters()
        self._script = script
        self._out: list[tuple[float, int, can.Message]] = []
        self._order = itertools.count()
        self._off_until_s = -math.inf
        self._periods: dict[tuple[DriveKey, str], float] = {
            (key, frame.name): frame.period_s * (place + 1) / (len(drives) + 1)
            for place, (key, drive) in enumerate(drives.items())
            for frame in _content(drive).table.frames_from(Sender.DRIVE)
            if frame.period_s
        }
        """(Drive, frame) → time when it is due. The drives' clocks are not in step."""

    # ---------------------------------------------------------------------------------- plugging
    def plug(self) -> None:
        """Plug the bus in, unless it is plugged. Raises OSError."""
        if not self.port.plugged:
            self.port.plug()
            self.counters.plugged += 1

    def pull(self) -> None:
        self.port.pull()
        self._out.clear()

    def go_off(self, until_s: float) -> None:
        """Report bus-off as the master's controller would. Nothing passes until `until_s`."""
        message = can.Message(
            arbitration_id=BUS_OFF_IDENTIFIER,
            is_extended_id=False,
            is_error_frame=True,
            data=bytes(8),
        )
        self.port.put(message)
        self._off_until_s = until_s

    # ------------------------------------------------------------------------------- the poll loop
    def due_s(self, now_s: float) -> float:
        """Return the time of the next call of `work`, with or without frames."""
        if not self.port.plugged:
            return math.inf
        next_out_s = self._out[0][0] if self._out else math.inf
        return min(next_out_s, self.port.due_s(now_s), *self._periods.values(), math.inf)

    def work(self, now_s: float, clock: Clock | None = None) -> None:
        """Take in what has come, and send what is due."""
        if not self.port.plugged:
            return
        del clock
        for _ in range(TAKE_AT_ONCE):
            message = self.port.take_in()
            if message is None:
                break
            if now_s >= self._off_until_s and not message.is_error_frame:
                self._obey(message, now_s)
        self._speak(now_s)
        while self._out and self._out[0][0] <= now_s:
            _, _, message = heapq.heappop(self._out)
            went = now_s >= self._off_until_s and self.port.put(message)
            self.counters.sent += went
            self.counters.lost += not went

    def stats(self) -> dict[str, Any]:
        return {
            **asdict(self.counters),
            "units": {str(drive.unit): asdict(drive.stats) for drive in self.drives.values()},
        }

    # ----------------------------------------------------------------------------- from the master
    def _obey(self, message: can.Message, now_s: float) -> None:
        self.counters.frames += 1
        known = False
        for drive in self.drives.values():
            table, unit = _content(drive).table, drive.unit
            sender = Sender.DRIVE if message.is_remote_frame else Sender.MOTORD
            for frame in table.frames_from(sender):
                named = frame.identifier(unit) == message.arbitration_id
                if named and frame.is_extended(unit) == message.is_extended_id:
                    known |= self._execute(drive, frame, message, now_s)
        self.counters.unanswered += not known

    def _execute(
        self, drive: SimulatedDrive, frame: Frame, message: can.Message, now_s: float
    ) -> bool:
        """Execute a frame. Return whether the drive has received and understood it."""
        unit = drive.unit
        if not drive.on or self._script.silent(unit, now_s):
            return False
        if any(f.kind == "unheard" and f.strikes(unit, now_s) for f in self._script.faults):
            return True
        content = _content(drive)
        if message.is_remote_frame:
            drive.execute_can([], now_s)
            self._reply(drive, frame, now_s)
            return True
        data = bytes(message.data)
        if frame.node_byte is not None and data[frame.node_byte :][:1] not in (
            b"\0",
            bytes((unit,)),
        ):
            return False
        taken: list[tuple[str, int]] = []
        for one, its_data in drive.due(frame, data):
            if not drive.obeys(one) or (written := content.written(one, its_data)) is None:
                return False
            taken += written
        drive.execute_can(taken, now_s)
        for answer in content.answers(frame):
            if drive.sends(answer):
                self._reply(drive, answer, now_s)
        return True

    def _reply(self, drive: SimulatedDrive, frame: Frame, now_s: float) -> None:
        turnaround_s = self._script.turnaround_s(drive.unit, now_s)
        if turnaround_s is None:
            turnaround_s = TURNAROUND_PART * drive.profile.turnaround_s
        self._say(drive, frame, now_s + turnaround_s, now_s)

    # ----------------------------------------------------------------------------- from the drives
    def _speak(self, now_s: float) -> None:
        """Queue frames that the drives send by themselves. A missed time is not made up for."""
        for (key, name), due_s in self._periods.items():
            if now_s < due_s:
                continue
            drive = self.drives[key]
            frame = _content(drive).table.frames[name]
            self._periods[key, name] = max(due_s + frame.period_s, now_s)
            if drive.on and drive.sends(frame) and not self._script.silent(drive.unit, now_s):
                self._say(drive, frame, now_s, now_s)

    def _say(self, drive: SimulatedDrive, frame: Frame, at_s: float, now_s: float) -> None:
        """Queue the frame with its present content, unless a fault spoils it."""
        node = unit = drive.unit
        for fault in self._script.faults:
            if fault.kind not in ("drop", "delay", "wrong-unit") or not fault.strikes(unit, now_s):
                continue
            if fault.kind == "drop":
                self.counters.lost += 1
                return
            if fault.kind == "delay":
                at_s += fault.values["ms"] / 1000.0
            else:
                table = _content(drive).table
                node = table.node_min + (unit - table.node_min + 1) % (table.node_max + 1)
        message = can.Message(
            arbitration_id=frame.identifier(node),
            is_extended_id=frame.is_extended(node),
            is_fd=frame.fd,
            bitrate_switch=frame.fd,
            data=_content(drive).sent(frame),
        )
        heapq.heappush(self._out, (at_s, next(self._order), message))


def _content(drive: SimulatedDrive) -> CanContent:
    assert isinstance(drive.registers, CanContent)  # the rig ensures it
    return drive.registers
