# SPDX-License-Identifier: Apache-2.0
"""A board on a serial port that takes a stream of set-points and sends a stream of feedback.

There is no request and no reply. A cycle: look whether the wheels have to stop, let the job that
is under way take its step, send one frame with the newest set-points. Feedback is taken in whenever
it comes. A board that is not heard is told to stop, in every cycle.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence

from motord_hal.asyncio_engine.line import LOOK_EVERY_S, AsyncioLine
from motord_hal.asyncio_engine.tally import RoundTripTally
from motord_hal.base.clock import now_ns
from motord_hal.base.errors import NoReply, ProfileError
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.parameter import readable
from motord_hal.fieldbus.plan import REST
from motord_hal.fieldbus.ports import DriveState, EventKind, LineSpec, LineStats, Listener
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.mcu.board import Board
from motord_hal.mcu.dialect import Dialect, Said
from motord_hal.mcu.frame_dialect import FrameDialect
from motord_hal.mcu.link import Stream
from motord_hal.mcu.pace import period_s, wire_limit_hz
from motord_hal.realtime.exchange import Exchange


class McuLine(AsyncioLine[Board]):
    """ports.Line for `kind = "mcu"`, engine "asyncio"."""

    deaf = "the port takes no bytes"
    least_pause_s = 0.001
    """Also where the port takes no bytes."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        if len(list(joints_by_unit(spec))) != 1:
            raise ProfileError(f"{spec.name}: one board a line: all its joints have the same unit")
        self._dialect = self._new_dialect(spec)
        cycle_s = period_s(spec, self._dialect.wire_bytes())
        super().__init__(spec, exchange, listener, cycle_s)
        self._stream = Stream(spec, self._take_in)
        self._board = Board(
            spec, exchange, self._say, period_s=cycle_s, answers=self._dialect.answers
        )
        self._drives = [self._board]
        self._exchanges = 0
        self._errors: Counter[str] = Counter()
        self._round_trips = RoundTripTally()

    def _new_dialect(self, spec: LineSpec) -> Dialect:
        return FrameDialect(spec)

    def stats(self) -> LineStats:
        """As ports.Line.stats. An exchange is a feedback; a round trip is from set-points to the
        feedback that says that they were heard, without the time that the board kept it."""
        errors = Counter({"port": self._losses, "bad_reply": self._dialect.bad}) + self._errors
        return LineStats(
            exchanges=self._exchanges,
            cycles=self._cycles.count,
            reopened=self._reopened,
            errors=dict(+errors),
            cycle_hz=self._cycles.rate_hz,
            wire_limit_hz=wire_limit_hz(self.spec, self._dialect.wire_bytes()),
            round_trip=self._round_trips.percentiles(),
        )

    def _say(self, kind: EventKind, joints: tuple[str, ...], text: str) -> None:
        self._errors["no_reply"] += kind is EventKind.DRIVE_QUIET
        super()._say(kind, joints, text)

    # ---------------------------------------------------------------------------------- its stream
    async def _open_wire(self) -> None:
        self._dialect.reset()
        self._stream.open()

    def _close_medium(self) -> None:
        self._stream.close()

    def _look(self) -> None:
        self._board.check_quiet()

    async def _cycle(self) -> None:
        self._board.work()
        self._send(self._board)
        if self._board.state is not DriveState.UNKNOWN:
            self._backoff.reset()

    async def _cycle_at_rest(self, drives: Sequence[Board]) -> None:
        for board in drives:
            self._send(board)
        await asyncio.sleep(self._short_pause_s)

    async def _switch_off(self, drive: Board) -> bool:
        """False: the port takes no bytes now."""
        await drive.tell_power_off()
        sent = self._send(drive)
        await asyncio.sleep(2 * self._short_pause_s)  # until it is on the wire
        return sent

    @property
    def _short_pause_s(self) -> float:
        return min(self._period_s, LOOK_EVERY_S)

    def _send(self, board: Board) -> bool:
        """False: the port takes no bytes now."""
        wanted = self._wanted(board)
        data = self._dialect.setpoints(board.setpoints(wanted), now_ns())
        if self._stream.send(data):
            board.sent(motion=any(wish != REST for wish in wanted.values()))
            return True
        self._errors["no_room"] += 1
        return False

    def _take_in(self, data: bytes) -> None:
        for said in self._dialect.feed(data, now_ns()):
            self._exchanges += 1
            if said.round_trip_s is not None:
                self._round_trips.add(said.round_trip_s)
            self._hand_on_imu(said)
            self._board.hear(said)

    def _hand_on_imu(self, said: Said) -> None:
        """To the core, where the robot file says that this board's sensor is the robot's."""
        mounting = self.spec.imu
        if mounting is not None and said.imu is not None:
            self._exchange.put_imu(
                stamp_ns=said.stamp_ns,
                angular_rad_s=mounting.to_base(said.imu.angular_rad_s),
                acceleration_m_s2=mounting.to_base(said.imu.acceleration_m_s2),
                saturated=said.imu.saturated,
                epoch=self._reopened,
            )

    # ---------------------------------------------------------------------------------------- jobs
    async def read_register(self, joint: str, register: str) -> float:
        """As ports.Line.read_register: from the newest feedback."""
        board = self._drive_of(joint)
        found = readable(board.plan.profile, register)
        self._check_open()
        raw = board.value(register)
        if raw is None:
            raise NoReply(f"{board} has not said its {register}")
        return found.to_si(raw)

    def _limit_s(self, jobs: Sequence[Job]) -> float:
        return sum(job.limit_s(max(self._period_s, LOOK_EVERY_S), 1) for job in jobs)
