# SPDX-License-Identifier: Apache-2.0
"""A board on a serial port that takes a stream of set-points and sends a stream of feedback.

There is no request and no reply. A cycle: look whether the wheels have to stop, let the job that
is under way take its step, send one frame with the newest set-points. Feedback is taken in whenever
it comes. A board that is not heard is told to stop, in every cycle.
"""

from __future__ import annotations

import asyncio
from collections import deque

from motord_hal.clock import now_ns, now_s, sleep_until_s
from motord_hal.drives.profile import DriveProfile
from motord_hal.engine.job import Job, clear_steps
from motord_hal.engine.parameter import readable, write_steps
from motord_hal.engine.units import joints_by_unit
from motord_hal.errors import DriveFault, HalError, NoReply, PortError, ProfileError
from motord_hal.mcu.board import Board, Wanted
from motord_hal.mcu.dialect import Dialect, Said
from motord_hal.mcu.frame_dialect import FrameDialect
from motord_hal.mcu.link import Stream
from motord_hal.mcu.pace import period_s, wire_limit_hz
from motord_hal.ports import (
    SETPOINT_TIMEOUT_S,
    DriveState,
    EventKind,
    LineEvent,
    LineSpec,
    LineState,
    LineStats,
    Listener,
    RoundTrips,
)
from motord_hal.retry import Backoff
from motord_hal.rt import Exchange, Setpoints

REOPEN_FIRST_S = 0.1
REOPEN_LIMIT_S = 2.0
SHUTDOWN_WITHIN_S = 0.5
SHUTDOWN_STOPPING_S = 0.35
"""So much of it may pass until the wheels are at rest; then the power goes off all the same."""
LOOK_EVERY_S = 0.02
"""Between cycles: how often it is looked whether the wheels have to stop."""
LEAST_PAUSE_S = 0.001
JOB_ALLOWANCE_S = 1.0
ROUND_TRIPS_KEPT = 2000
CYCLES_KEPT = 64


class McuLine:
    """ports.Line for `kind = "mcu"`, engine "asyncio"."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        if len(list(joints_by_unit(spec))) != 1:
            raise ProfileError(f"{spec.name}: one board a line: all its joints have the same unit")
        self.spec = spec
        self._exchange = exchange
        self._listener = listener
        self._dialect = self._new_dialect(spec)
        self._stream = Stream(spec, self._take_in)
        self._period_s = period_s(spec, self._dialect.wire_bytes())
        self._board = Board(
            spec, exchange, self._say, period_s=self._period_s, answers=self._dialect.answers
        )
        self._open = False
        self._said_lost = False
        self._backoff = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S)
        self._sent_s = 0.0
        self._told_motion = False
        self._stats = LineStats()
        self._errors = {"no_room": 0, "no_reply": 0, "port": 0}
        self._round_trips_s: deque[float] = deque(maxlen=ROUND_TRIPS_KEPT)
        self._cycle_starts_s: deque[float] = deque(maxlen=CYCLES_KEPT)

    def _new_dialect(self, spec: LineSpec) -> Dialect:
        return FrameDialect(spec)

    # ------------------------------------------------------------------------------------ what is
    @property
    def engine(self) -> str:
        return "asyncio"

    @property
    def state(self) -> LineState:
        if not self._open:
            return LineState.CLOSED
        unknown = self._board.state is DriveState.UNKNOWN
        return LineState.CONFIGURING if unknown else LineState.READY

    @property
    def drive_states(self) -> dict[str, DriveState]:
        return dict.fromkeys(self._board.names, self._board.state)

    @property
    def drive_faults(self) -> dict[str, tuple[str, ...]]:
        return {name: watch.words for name, watch in self._board.faults.items()}

    def stats(self) -> LineStats:
        """As ports.Line.stats. An exchange is a feedback; a round trip is from set-points to the
        feedback that says that they were heard, without the time that the board kept it."""
        stats, starts = self._stats, self._cycle_starts_s
        span_s = starts[-1] - starts[0] if len(starts) > 1 else 0.0
        ordered_s = sorted(self._round_trips_s)
        stats.errors = {kind: n for kind, n in self._errors.items() if n}
        if self._dialect.bad:
            stats.errors["bad_reply"] = self._dialect.bad
        stats.cycle_hz = (len(starts) - 1) / span_s if span_s > 0 else 0.0
        stats.wire_limit_hz = wire_limit_hz(self.spec, self._dialect.wire_bytes())
        if ordered_s:
            last = len(ordered_s) - 1
            places = (round(last * part) for part in (0.5, 0.99, 1.0))
            stats.round_trip = RoundTrips(*(ordered_s[place] * 1e6 for place in places))
        return stats

    def _say(self, kind: EventKind, joints: tuple[str, ...], text: str) -> None:
        self._errors["no_reply"] += kind is EventKind.DRIVE_QUIET
        self._listener(LineEvent(kind, self.spec.name, joints, text))

    # ------------------------------------------------------------------------------------ the task
    async def run(self) -> None:
        """As ports.Line.run."""
        try:
            while True:
                await self._open_port()
                try:
                    await self._go_round()
                except PortError as error:
                    self._lose_port(error)
        finally:
            try:
                await self._shut_down()
            finally:
                self._close(PortError(f"{self.spec.name} is closed"))

    async def _open_port(self) -> None:
        while True:
            if self._said_lost:
                await asyncio.sleep(self._backoff.next_s())
            try:
                self._dialect.reset()
                self._stream.open()
                break
            except PortError as error:
                self._lose_port(error)
        if self._said_lost:
            self._stats.reopened += 1
        self._open, self._said_lost = True, False
        names = self._board.names
        self._say(EventKind.LINE_OPEN, names, f"{self.spec.name} is open on {self.spec.port}")
        self._board.begin()

    def _lose_port(self, error: PortError) -> None:
        self._errors["port"] += 1
        self._close(error)
        if not self._said_lost:
            self._said_lost = True
            self._say(EventKind.LINE_LOST, self._board.names, f"{self.spec.name}: {error}")

    def _close(self, error: PortError) -> None:
        self._open = False
        self._stream.close()
        self._board.lose(error)

    async def _go_round(self) -> None:
        """Cycle for ever at `cycle_hz`; a late cycle is not caught up. Raises PortError."""
        due_s = now_s()
        while True:
            self._stats.cycles += 1
            self._cycle_starts_s.append(now_s())
            self._board.check_quiet()
            self._obey_setpoints()
            self._board.work()
            self._send()
            if self._board.state is not DriveState.UNKNOWN:
                self._backoff.reset()
            due_s = max(due_s + self._period_s, now_s())
            await self._wait_for_cycle(due_s)
            due_s = min(due_s, now_s())

    async def _wait_for_cycle(self, due_s: float) -> None:
        """A stop does not wait for the next cycle of a slow line; nor does it take all of the event
        loop where the port takes no bytes."""
        await asyncio.sleep(LEAST_PAUSE_S)
        while now_s() < due_s and not self._has_to_stop():
            await sleep_until_s(min(due_s, now_s() + LOOK_EVERY_S))

    def _has_to_stop(self) -> bool:
        return self._told_motion and not any(any(wish) for wish in self._wanted().values())

    def _send(self) -> None:
        wanted = self._wanted()
        data = self._dialect.setpoints(self._board.setpoints(wanted), now_ns())
        if self._stream.send(data):
            self._sent_s = now_s()
            self._told_motion = any(any(wish) for wish in wanted.values())
            self._board.sent()
        else:
            self._errors["no_room"] += 1

    def _take_in(self, data: bytes) -> None:
        for said in self._dialect.feed(data, now_ns()):
            self._note(said)
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
                epoch=self._stats.reopened,
            )

    def _note(self, said: Said) -> None:
        self._stats.exchanges += 1
        if said.round_trip_s is not None:
            self._round_trips_s.append(said.round_trip_s)

    # ------------------------------------------------------------------------------------- safety
    def _wanted(self) -> Wanted:
        """The newest set-points, or nothing at all: the board is then told zero."""
        newest = self._exchange.take_setpoints(self.spec.index)
        armed = self._board.state is DriveState.ARMED
        if not armed or not newest.enabled or not _fresh(newest):
            return {}
        return {
            joint.index: (
                newest.joints[joint.index].velocity_rad_s,
                newest.joints[joint.index].duty,
            )
            for joint in self._board.plan.joints
            if joint.index < len(newest.joints)
        }

    def _obey_setpoints(self) -> None:
        """Old set-points: quick stop. Not enabled any more: power off. Both before all else. A
        board that was left alone for longer than its watchdog has stopped by itself."""
        board = self._board
        if board.state is not DriveState.ARMED:
            return
        newest = self._exchange.take_setpoints(self.spec.index)
        if not _fresh(newest) or now_s() - self._sent_s > board.watchdog_s:
            board.quick_stop()
        elif newest.enabled:
            board.was_enabled = True
        elif board.was_enabled:
            board.power_off()

    async def _shut_down(self) -> None:
        """Quick stop, then power off; within SHUTDOWN_WITHIN_S."""
        if not self._open:
            return
        board, pause_s = self._board, min(self._period_s, LOOK_EVERY_S)
        stopping_by_s = now_s() + SHUTDOWN_STOPPING_S
        try:
            async with asyncio.timeout(SHUTDOWN_WITHIN_S):
                if board.state is DriveState.ARMED:
                    board.quick_stop()
                while board.is_stopping and now_s() < stopping_by_s:
                    self._send()
                    await asyncio.sleep(pause_s)
                board.power_off()
                self._send()
                await asyncio.sleep(2 * pause_s)  # until it is on the wire
        except (TimeoutError, PortError) as error:
            text = f"{self.spec.name}: the board was not switched off at the end: {error}"
            self._say(EventKind.DRIVE_WARNING, board.names, text)

    # ---------------------------------------------------------------------------------------- jobs
    async def arm(self) -> None:
        """As ports.Line.arm."""
        self._check_ready_to_arm()
        if self._board.state is DriveState.ARMED:
            return
        armed = False
        try:
            await self._finish(self._board.submit(self._board.arming()))
            armed = True
        finally:
            if not armed:
                self._board.power_off()

    def _check_ready_to_arm(self) -> None:
        self._check_open()
        board = self._board
        if board.state in (DriveState.QUIET, DriveState.UNKNOWN):
            raise NoReply(f"{board} is {board.state.value}: it cannot be armed")
        for name, watch in board.faults.items():
            if watch.stopping:
                raise DriveFault(f"{name} reports {', '.join(watch.words)}")
        if not _fresh(self._exchange.take_setpoints(self.spec.index)):
            raise HalError(f"{self.spec.name}: no fresh set-points: is the loop running?")

    async def disarm(self) -> None:
        """As ports.Line.disarm. From the call on, every set-point is zero."""
        self._check_open()
        if self._board.state is not DriveState.QUIET:
            await self._finish(self._board.standing_down())

    async def clear_faults(self) -> None:
        """As ports.Line.clear_faults. A board without a fault is left as it is."""
        self._check_open()
        board = self._board
        if not any(watch.word for watch in board.faults.values()):
            return
        if board.state in (DriveState.READY, DriveState.ARMED):
            board.power_off()
            await self._finish(board.submit(Job("clear", clear_steps(board.plan.profile))))

    async def read_register(self, joint: str, register: str) -> float:
        """As ports.Line.read_register: from the newest feedback."""
        found = readable(self._profile_of(joint), register)
        self._check_open()
        raw = self._board.value(register)
        if raw is None:
            raise NoReply(f"{self._board} has not said its {register}")
        return found.to_si(raw)

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """As ports.Line.write_register."""
        profile = self._profile_of(joint)
        steps = write_steps(profile, register, value)
        self._check_open()
        job = self._board.submit(Job("write", steps))
        await self._finish(job)
        return profile.registers[register].to_si(job.raw)

    def _profile_of(self, joint: str) -> DriveProfile:
        if joint not in self._board.names:
            raise LookupError(f'{self.spec.name} has no joint "{joint}"')
        return self._board.plan.profile

    def _check_open(self) -> None:
        if not self._open:
            raise PortError(f"{self.spec.name} is not open on {self.spec.port}")

    async def _finish(self, job: Job) -> None:
        """Wait for it; raises its HalError, or NoReply when it takes too long."""
        limit_s = JOB_ALLOWANCE_S + job.limit_s(max(self._period_s, LOOK_EVERY_S), 1)
        try:
            async with asyncio.timeout(limit_s):
                await job.done
        except TimeoutError:
            raise NoReply(f"{self.spec.name}: {job.name} was not done in {limit_s:.1f} s") from None


def _fresh(newest: Setpoints) -> bool:
    return newest.stamp_ns > 0 and now_ns() - newest.stamp_ns <= SETPOINT_TIMEOUT_S * 1e9
