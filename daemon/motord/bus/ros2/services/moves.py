# SPDX-License-Identifier: Apache-2.0
"""The actions drive_distance, rotate and calibrate (motord_msgs/action). The motions are in
motord/api/motion.py and bus/commands/mover.py, the measures in bus/messages/calibration.py."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import TYPE_CHECKING

from motord.api.motion import End, Goal, Motion, MotionStep, Plan
from motord.api.snapshot import Snapshot
from motord.api.state_page import NoPage, StatePage
from motord.bus.commands.mover import Mover, NotNow
from motord.bus.commands.senders import Sender
from motord.bus.messages.calibration import Calibration, Found, Measure, measure
from motord.bus.ros2.nodes import Node
from motord.bus.ros2.services.actions import ActionServer, Refused, Report, Status, Turn, Work

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

LOOK_EVERY_S = 0.05
_ENDS = {
    End.SUCCEEDED: Status.SUCCEEDED,
    End.CANCELED: Status.CANCELED,
    End.ABORTED: Status.ABORTED,
}
_DISTANCE_NOTHING = SimpleNamespace(distance_m=0.0, turned_rad=0.0, duration_s=0.0, message="")
_ANGLE_NOTHING = SimpleNamespace(angle_rad=0.0, moved_m=0.0, duration_s=0.0, message="")
_CALIBRATE_NOTHING = SimpleNamespace(
    factor=0.0, wheel_radius_m=0.0, track_m=0.0, distance_m=0.0, angle_rad=0.0, message=""
)


class Moves:
    """The actions of one input. Actions that move the robot take turns; calibrate only reads and
    does not block them."""

    def __init__(self, runtime: Runtime, mover: Mover, goal_lease_s: float | None) -> None:
        """`goal_lease_s`: see `ActionServer`, for the actions that move the robot."""
        self._runtime = runtime
        self._mover = mover
        moving, watching = Turn(), Turn()
        package = "motord_msgs/action"
        self._servers = (
            ActionServer(
                "drive_distance",
                f"{package}/DriveDistance",
                self._drive,
                _DISTANCE_NOTHING,
                moving,
                goal_lease_s,
            ),
            ActionServer(
                "rotate", f"{package}/Rotate", self._rotate, _ANGLE_NOTHING, moving, goal_lease_s
            ),
            ActionServer(
                "calibrate", f"{package}/Calibrate", self._calibrate, _CALIBRATE_NOTHING, watching
            ),
        )

    def serve(self, node: Node) -> None:
        """Offer the actions on a node. Raises DdsError."""
        for server in self._servers:
            server.serve(node)

    def alive(self, message: SimpleNamespace, _: float, __: Sender) -> None:
        """Take the id of a goal whose client lives."""
        for server in self._servers:
            server.alive(bytes(message.uuid))

    def runs(self) -> tuple[Callable[[], Coroutine[None, None, None]], ...]:
        """Return the functions to run, each in a task of its own until cancelled."""
        return tuple(server.run for server in self._servers)

    # ------------------------------------------------------------------------------------ motions
    async def _drive(self, goal: SimpleNamespace) -> Work:
        asked = Goal(
            axis="linear",
            distance_u=goal.distance_m,
            velocity_u_s=goal.speed_m_s,
            tolerance_u=goal.tolerance_m,
            timeout_s=goal.timeout_s,
            direction_rad=goal.direction_rad,
        )
        return self._work(await self._planned(asked), _distance_feedback, _distance_result)

    async def _rotate(self, goal: SimpleNamespace) -> Work:
        asked = Goal(
            axis="angular",
            distance_u=goal.angle_rad,
            velocity_u_s=goal.speed_rad_s,
            tolerance_u=goal.tolerance_rad,
            timeout_s=goal.timeout_s,
        )
        return self._work(await self._planned(asked), _angle_feedback, _angle_result)

    async def _planned(self, asked: Goal) -> Plan:
        try:
            return await self._mover.plan(asked)
        except NotNow as error:
            raise Refused(str(error)) from error

    def _work(
        self,
        plan: Plan,
        feedback: Callable[[Motion, Snapshot], SimpleNamespace],
        result: Callable[[Motion | None, float, str], SimpleNamespace],
    ) -> Work:
        async def work(report: Report, cancel: asyncio.Event) -> tuple[Status, SimpleNamespace]:
            begin_s = time.monotonic()
            step, motion = await self._mover.move(
                plan, lambda motion, newest: report(feedback(motion, newest)), cancel
            )
            return _ended(step), result(motion, time.monotonic() - begin_s, step.why)

        return work

    # ---------------------------------------------------------------------------------- measuring
    async def _calibrate(self, goal: SimpleNamespace) -> Work:
        try:
            asked = measure(
                goal.quantity, goal.true_distance_m, goal.true_angle_rad, goal.timeout_s
            )
        except ValueError as error:
            raise Refused(str(error)) from error

        async def work(report: Report, cancel: asyncio.Event) -> tuple[Status, SimpleNamespace]:
            try:
                with self._runtime.page() as page:
                    return await self._watch(asked, page, report, cancel)
            except NoPage as error:
                return Status.ABORTED, _with(_CALIBRATE_NOTHING, message=str(error))

        return work

    async def _watch(
        self, asked: Measure, page: StatePage, report: Report, cancel: asyncio.Event
    ) -> tuple[Status, SimpleNamespace]:
        newest = page.read()
        if newest is None:
            return Status.ABORTED, _with(_CALIBRATE_NOTHING, message="there is no state yet")
        watched = Calibration(asked, newest, time.monotonic_ns(), self._mover.stale_s)
        while not cancel.is_set():
            newest = page.read() or newest
            found = watched.step(newest, time.monotonic_ns())
            if found is not None:
                return _ENDS[found.end], self._calibrated(asked, watched, found)
            report(
                SimpleNamespace(
                    distance_m=watched.travel.distance_m,
                    angle_rad=watched.travel.angle_rad,
                    at_rest=newest.at_rest,
                )
            )
            await asyncio.sleep(LOOK_EVERY_S)
        return Status.CANCELED, _with(_CALIBRATE_NOTHING, message="canceled")

    def _calibrated(self, asked: Measure, watched: Calibration, found: Found) -> SimpleNamespace:
        """Return the result of a calibration, with the robot file's values for what was not
        measured."""
        base = self._runtime.robot.base
        radius_m, track_m = base.wheel_radius_m, base.track_m
        if found.end is End.SUCCEEDED:
            if asked.quantity == "wheel_radius":
                radius_m *= found.factor
            else:
                track_m *= found.factor
        return SimpleNamespace(
            factor=found.factor,
            wheel_radius_m=radius_m,
            track_m=track_m,
            distance_m=watched.travel.distance_m,
            angle_rad=watched.travel.angle_rad,
            message=found.why,
        )


def _ended(step: MotionStep) -> Status:
    assert step.end is not None
    return _ENDS[step.end]


def _distance_feedback(motion: Motion, newest: Snapshot) -> SimpleNamespace:
    return SimpleNamespace(
        distance_m=motion.distance_u,
        remaining_m=motion.remaining_u,
        speed_m_s=motion.plan.along_m_s(newest),
    )


def _angle_feedback(motion: Motion, newest: Snapshot) -> SimpleNamespace:
    return SimpleNamespace(
        angle_rad=motion.distance_u,
        remaining_rad=motion.remaining_u,
        speed_rad_s=newest.angular_rad_s,
    )


def _distance_result(motion: Motion | None, duration_s: float, why: str) -> SimpleNamespace:
    if motion is None:
        return _with(_DISTANCE_NOTHING, message=why)
    travel = motion.travel
    return SimpleNamespace(
        distance_m=travel.distance_m,
        turned_rad=travel.angle_rad,
        duration_s=duration_s,
        message=why,
    )


def _angle_result(motion: Motion | None, duration_s: float, why: str) -> SimpleNamespace:
    if motion is None:
        return _with(_ANGLE_NOTHING, message=why)
    travel = motion.travel
    return SimpleNamespace(
        angle_rad=travel.angle_rad, moved_m=travel.distance_m, duration_s=duration_s, message=why
    )


def _with(result: SimpleNamespace, *, message: str) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(result), "message": message})
