# SPDX-License-Identifier: Apache-2.0
"""The loop's end of an exchange, and a line that runs: what tests of lines share."""

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
"""The age from which set-points are old to lines here. In the product a thread that waits for
nothing puts them; here one event loop does, and a busy machine may leave it without a CPU for
longer than the product allows."""
REPLY_S, UNRESPONSIVE_S = 0.2, 0.6
"""Of drives here, which share this process: a later reply does not count, and a drive
without feedback for this time is unresponsive."""
BOARDS = ("mcu", "ascii", "hoverboard", "sabertooth")


async def until(condition: Callable[[], bool], what: str = "") -> None:
    """Wait for a condition, with a deadline that only a hung program meets."""
    try:
        async with asyncio.timeout(GENEROUS_S):
            while not condition():  # a condition of the world, not of ours
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
    """Puts set-points as the loop's tick does; `running = False`: the loop has died."""

    exchange: Exchange
    line: int = 0
    joints: int = 8
    enabled: bool = False
    velocity_rad_s: dict[int, float] = field(default_factory=dict)
    duty: dict[int, float] = field(default_factory=dict)
    position_rad: dict[int, float] = field(default_factory=dict)
    """Of joints that take positions; the others have no target."""
    speed_loops: dict[int, SpeedLoop] = field(default_factory=dict)
    """Of joints whose drives take a torque."""
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
        """Enabled, and no longer so before a line looks: an emergency stop right after arming."""
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
    """A line under test, its loop side, and what it logged."""

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
        """Once more if a peer was unresponsive meanwhile, as on a busy machine."""
        refusals: list[str] = []
        try:
            async with asyncio.timeout(GENEROUS_S):
                while not await self._armed_now(refusals):
                    await asyncio.sleep(0.01)
        except TimeoutError:
            logged = [event.text for event in self.events]
            raise AssertionError(f"never armed: {refusals[-3:]}, logged: {logged[-5:]}") from None

    async def drive(self, condition: Callable[[], bool], what: str) -> None:
        """Armed and enabled until the condition holds. A line that had no set-points for longer
        than PATIENT_S, or a drive that was not fed for as long as its watchdog waits, has stopped,
        as it must: then once more, and it is printed."""
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
    """The line with time-outs that a busy machine does not miss."""
    joints = tuple(_patient_joint(joint, spec) for joint in spec.joints)
    return dataclasses.replace(spec, joints=joints, setpoint_timeout_s=PATIENT_S)


def _patient_joint(joint: JointSpec, spec: LineSpec) -> JointSpec:
    if spec.kind in BOARDS:  # which are unresponsive after so many cycles
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
    """The line, running, until the end of the block; then it is cancelled. `in_haste`: with the
    time-outs of the product, where the test is about them."""
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
            print(*events, sep="\n")  # shown where the test has failed
