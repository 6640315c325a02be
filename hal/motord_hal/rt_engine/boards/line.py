# SPDX-License-Identifier: Apache-2.0
"""The line of a board whose cycle runs in C."""

from __future__ import annotations

from collections import Counter

from motord_hal.base.errors import NoReply, ProfileError
from motord_hal.fieldbus.parameter import readable
from motord_hal.fieldbus.ports import DriveState, LineSpec, LineStats, Listener, RoundTrips
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.mcu.pace import period_s, wire_limit_hz
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.board import BoardReport, BoardThread, check_table
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.thread import cpu_mask
from motord_hal.rt_engine.base import RtLineBase
from motord_hal.rt_engine.boards.drive import BoardRtDrive
from motord_hal.rt_engine.boards.jobs import BoardJobs
from motord_hal.rt_engine.boards.layout import layout_of, wire_bytes
from motord_hal.rt_engine.boards.table import board_table
from motord_hal.serial.port import OpenPort, open_port


class RtBoardLine(RtLineBase[BoardReport, BoardRtDrive]):
    """Implements ports.Line for the kinds "mcu", "ascii", "hoverboard" and "sabertooth" with the
    engine "rt"."""

    _thread: BoardThread

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        super().__init__(spec, listener)
        _check_boards(spec)
        self._thread = BoardThread(spec.index, exchange)
        plan = DrivePlan(spec.joints, 0.0, lambda _: 0.0)
        size_bytes = wire_bytes(spec, plan.profile.channels)
        cycle_s = period_s(spec, size_bytes)
        layout = layout_of(spec, plan, cycle_s)
        self._wire_limit_hz = wire_limit_hz(spec, size_bytes)
        self._table = board_table(spec, plan, layout, cycle_s, 1.0 / self._wire_limit_hz)
        check_table(spec.name, self._table)
        names = ", ".join(joint.name for joint in plan.joints)
        jobs = BoardJobs(f"the board of {names}", plan, layout, self._thread, cycle_s)
        silence_s = self._table["silence_ns"] * 1e-9
        self._drives = [
            BoardRtDrive(jobs, spec, self._thread, self._notifier, self._say, silence_s),
        ]
        self._port: OpenPort | None = None
        self._errors: Counter[str] = Counter()
        self._exchanges = self._cycles = 0
        self._round_trips = RoundTrips()
        self._epoch = 0
        """Epoch of the newest feedback. The next thread continues from it, so that feedback after a
        reopening counts as new, even if its counters look the same."""

    def stats(self) -> LineStats:
        """Implement `ports.Line.stats`. An exchange is one feedback; a round trip is from
        set-points to the feedback that acknowledges them, without the board's own delay."""
        stats = LineStats(
            exchanges=self._exchanges,
            cycles=self._cycles,
            reopened=self._reopened,
            errors=dict(self._counted()),
            requested_hz=self.spec.cycle_hz,
            wire_limit_hz=self._wire_limit_hz,
            round_trip=self._round_trips,
        )
        if self._report is not None:
            report = self._thread.report()
            stats.exchanges += report.received
            stats.cycles += report.cycles
            stats.cycle_hz = 1e9 / report.cycle_ns if report.cycle_ns else 0.0
            stats.errors = dict(self._counted() + _errors(report))
            stats.round_trip = self._thread.round_trips()
        return stats

    def _counted(self) -> Counter[str]:
        """Return the errors that earlier threads and the line itself have counted."""
        return self._errors + Counter({"port": self._losses})

    # ------------------------------------------------------------------------------------- the port
    async def _start(self) -> tuple[str, ...]:
        self._port = open_port(self.spec)
        self._port.flush()
        self._thread.start(
            self._table | {"imu": self._table["imu"] | {"epoch": self._reopened}},
            fd=self._port.fd,
            event_fd=self._notifier.event_fd,
            priority=self.spec.priority,
            epoch=self._epoch,
            left_running=int(self.spec.left_running),
            cpu_mask=cpu_mask(self.spec),
        )
        self._report = self._thread.report()
        return self._port.facts

    def _close_port(self) -> None:
        if self._report is not None:
            last = self._thread.report()
            self._exchanges += last.received
            self._cycles += last.cycles
            self._epoch = last.drives[0].epoch
            self._errors += _errors(last)
            self._round_trips = self._thread.round_trips()
        if self._port is not None:
            self._port.close()
            self._port = None

    def _is_steady(self, report: BoardReport) -> bool:
        return report.received > 0

    # ---------------------------------------------------------------------------------- parameters
    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register` with the newest feedback."""
        drive = self._drive_of(joint)
        found = readable(drive.jobs.profile, register)
        self._check_open()
        raw = None if drive.state is DriveState.UNRESPONSIVE else drive.jobs.value(register)
        if raw is None:
            raise NoReply(f"{drive} has not reported its {register}")
        return found.to_si(raw)


def _check_boards(spec: LineSpec) -> None:
    """Raise ProfileError if the boards cannot share a line."""
    boards = list(joints_by_unit(spec))
    if spec.kind != "sabertooth" and len(boards) != 1:
        raise ProfileError(f"{spec.name}: one board a line: all its joints have the same unit")
    if len({joints[0].profile.name for joints in boards}) != 1:
        raise ProfileError(f"{spec.name}: drivers on one wire have the same profile")


def _errors(report: BoardReport) -> Counter[str]:
    """Return the errors in a report by their kind, without counters of zero."""
    counts = {
        "bad_reply": report.bad_frames,
        "no_room": report.no_room,
        "no_reply": report.unresponsive,
    }
    return Counter({kind: count for kind, count in counts.items() if count})
