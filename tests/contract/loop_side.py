# SPDX-License-Identifier: Apache-2.0
"""Helpers of tests of lines: the loop's end of an exchange, and a line that runs."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field

from _motord_rt import ffi, lib

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, Line, LineEvent, LineSpec
from motord_hal.realtime.exchange import Exchange, JointSetpoint, Setpoints

GENEROUS_S = 60.0
LOOK_EVERY_S = 0.01
SETPOINTS_EVERY_S = 0.01
PATIENT_S = 1.0
"""Age from which set-points are old for the lines of these tests. In the product a real-time thread
puts set-points; here the event loop does, and on a busy machine it may get no CPU for longer than
the product allows."""
REPLY_S, UNRESPONSIVE_S = 0.2, 0.6
"""Time-outs for the drives of these tests, which share this process: a reply after REPLY_S does not
count, and a drive without feedback for UNRESPONSIVE_S is unresponsive."""
BOARDS = ("mcu", "ascii", "hoverboard", "sabertooth")


async def until(condition: Callable[[], bool], what: str = "") -> None:
    """Wait for a condition; fail after GENEROUS_S, which is enough unless a program hangs."""
    try:
        async with asyncio.timeout(GENEROUS_S):
            while not condition():  # no event reports that it is true
                await asyncio.sleep(LOOK_EVERY_S)
    except TimeoutError:
        raise AssertionError(f"never came true: {what or condition}") from None


LOOP = {
    "gains": {"gain_u_s_per_rad": 0.7, "integral_u_per_rad": 1.4},
    "correction_max_u": 3.0,
    "output_min_u": -3.0,
    "output_max_u": 3.0,
    "kind": lib.SPEED_LOOP_TORQUE,
}


class SpeedLoop:
    """The core's speed loop, for a wheel whose drive takes a torque."""

    def __init__(self):
        self._state = ffi.new("speed_loop_state *", {"begun": 1})
        self._config = ffi.new("speed_loop_config *", LOOP)

    def torque_n_m(self, want_rad_s: float, measured_rad_s: float) -> float:
        step = ffi.new(
            "speed_loop_input *",
            {
                "want_rad_s": want_rad_s,
                "measured_rad_s": measured_rad_s,
                "low_u": self._config.output_min_u,
                "high_u": self._config.output_max_u,
            },
        )
        return lib.speed_loop_step(
            self._state, self._config, ffi.addressof(self._config, "gains"), step, SETPOINTS_EVERY_S
        )


@dataclass
class LoopSide:
    """Stand-in for the real-time loop: puts set-points while `running`; otherwise it has died."""

    exchange: Exchange
    line: int = 0
    joints: int = 8
    enabled: bool = False
    velocity_rad_s: dict[int, float] = field(default_factory=dict)
    duty: dict[int, float] = field(default_factory=dict)
    position_rad: dict[int, float] = field(default_factory=dict)
    """Target angle by index of each joint that takes positions; other joints have no target."""
    speed_loops: dict[int, SpeedLoop] = field(default_factory=dict)
    """Speed loop by index of each joint whose drive takes a torque."""
    running: bool = True
    put_ns: int = 0
    """Stamp of the newest set-points."""

    def put(self) -> None:
        self.put_ns = now_ns()
        wheels = tuple(
            JointSetpoint(
                self.velocity_rad_s.get(n, 0.0),
                self.duty.get(n, 0.0),
                self._torque_n_m(n),
                self.position_rad.get(n),
            )
            for n in range(self.joints)
        )
        self.exchange.put_setpoints(self.line, Setpoints(self.put_ns, 1, self.enabled, wheels))

    def put_for_a_moment(self) -> None:
        """Put enabled, then disabled set-points at once: an emergency stop right after arming."""
        self.enabled = True
        self.put()
        self.enabled = False
        self.put()

    def _torque_n_m(self, joint: int) -> float:
        loop = self.speed_loops.get(joint)
        if loop is None or not self.enabled:
            return 0.0
        measured_rad_s = self.exchange.take_feedback(joint).velocity_rad_s
        return loop.torque_n_m(self.velocity_rad_s.get(joint, 0.0), measured_rad_s)

    async def tick(self) -> None:
        while True:
            if self.running:
                self.put()
            await asyncio.sleep(SETPOINTS_EVERY_S)


@dataclass
class Rig:
    """A line under test, its loop side, and the events that it reported."""

    line: Line
    loop: LoopSide
    events: list[LineEvent]
    task: asyncio.Task[None]

    def kinds(self) -> list[EventKind]:
        return [event.kind for event in self.events]

    def states(self) -> set[DriveState]:
        return set(self.line.drive_states.values())

    async def ready(self) -> None:
        await until(lambda: self.states() == {DriveState.READY}, "every drive is ready")

    async def arm(self) -> None:
        """Arm the line; repeat it if a peer was unresponsive meanwhile, as on a busy machine."""
        refusals: list[str] = []
        try:
            async with asyncio.timeout(GENEROUS_S):
                while not await self._armed_now(refusals):
                    await asyncio.sleep(0.01)
        except TimeoutError:
            logged = [event.text for event in self.events]
            raise AssertionError(f"never armed: {refusals[-3:]}, logged: {logged[-5:]}") from None

    async def drive(self, condition: Callable[[], bool], what: str) -> None:
        """Keep the line armed and enabled until the condition holds. The line stops where it had
        no set-points for longer than PATIENT_S, and a drive where its watchdog was not fed in time.
        After such a stop print the states and arm again."""
        try:
            async with asyncio.timeout(GENEROUS_S):
                while not condition():
                    if self.states() != {DriveState.ARMED}:
                        print("before it drove:", self.states())
                        self.loop.enabled = False
                        self.loop.put()
                        await self.arm()
                    self.loop.enabled = True
                    await asyncio.sleep(LOOK_EVERY_S)
        except TimeoutError:
            raise AssertionError(f"never came true: {what}: {self.states()}") from None

    async def _armed_now(self, refusals: list[str]) -> bool:
        await self.ready()
        try:
            await self.line.arm()
        except HalError as error:
            refusals.append(str(error))
        if self.states() == {DriveState.ARMED}:
            return True
        with contextlib.suppress(HalError):
            await self.line.disarm()
        return False


def patient(spec: LineSpec) -> LineSpec:
    """Return the line with time-outs that are long enough for a busy machine."""
    joints = tuple(_patient_joint(joint, spec) for joint in spec.joints)
    return dataclasses.replace(spec, joints=joints, setpoint_timeout_s=PATIENT_S)


def _patient_joint(joint: JointSpec, spec: LineSpec) -> JointSpec:
    if spec.kind in BOARDS:  # unresponsive after `tries` cycles without feedback
        return dataclasses.replace(
            joint, tries=max(joint.tries, round(UNRESPONSIVE_S * spec.cycle_hz))
        )
    table, profile = joint.profile.can, joint.profile
    if table is not None:
        frames = {
            name: dataclasses.replace(frame, silence_s=max(frame.silence_s, UNRESPONSIVE_S))
            if frame.silence_s
            else frame
            for name, frame in table.frames.items()
        }
        profile = dataclasses.replace(profile, can=dataclasses.replace(table, frames=frames))
    reply_timeout_s = joint.reply_timeout_s or REPLY_S
    return dataclasses.replace(joint, profile=profile, reply_timeout_s=reply_timeout_s)


@contextlib.asynccontextmanager
async def running(spec: LineSpec, *, in_haste: bool = False) -> AsyncIterator[Rig]:
    """Run the line until the end of the block, then cancel it. `in_haste`: with the time-outs of
    the product, for tests of those time-outs."""
    spec = spec if in_haste else patient(spec)
    loop = LoopSide(Exchange.private(), line=spec.index)
    for joint in spec.joints:
        if joint.profile.channels[joint.channel].torque_setpoint is not None:
            loop.speed_loops[joint.index] = SpeedLoop()
    loop.put()
    events: list[LineEvent] = []
    line = open_line(spec, loop.exchange, events.append)
    async with asyncio.TaskGroup() as group:
        ticking = group.create_task(loop.tick())
        task = group.create_task(line.run())
        try:
            yield Rig(line, loop, events, task)
        finally:
            task.cancel()
            await asyncio.wait([task])
            ticking.cancel()
            print(*events, sep="\n")  # pytest shows it when the test fails
