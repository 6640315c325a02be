# SPDX-License-Identifier: Apache-2.0
"""`move` and `turn` as a procedure: a distance or an angle, measured by the odometry
(motord.api.motion).

The procedure yields what it needs, a call of the daemon or a pause, and its driver sends back the
result: `motord.client` blocks for it, `motord.aio` awaits it. The program itself sends the
commands: if it ends or hangs, its lease expires and the robot stops."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from motord.api.local_rpc import ClientError, Refused
from motord.api.motion import (
    CANNOT_STRAFE,
    STOPS_EVERY_S,
    End,
    Goal,
    Motion,
    MotionStep,
    bounds_of,
    limit_names,
    obstacle,
    planned,
    problem,
)
from motord.api.snapshot import Snapshot
from motord.api.state_page import NoPage, StatePage

LOOK_EVERY_S = 0.02
STALE_S = 0.5
_LATCHED = ("fault", "estop")


@dataclass(frozen=True, slots=True)
class Call:
    """A method of the daemon that the driver calls; it sends the result back or throws
    ClientError."""

    method: str
    params: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Pause:
    """A time until which the driver waits."""

    until_s: float
    """On CLOCK_MONOTONIC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moved:
    """How a move or a turn ended, and how far it went."""

    end: End
    why: str
    """Empty if it succeeded."""
    distance_m: float
    angle_rad: float
    duration_s: float


class MoveFailed(ClientError):
    """A move or a turn did not begin, or did not reach its goal; the message is the reason."""

    def __init__(self, why: str, *, moved: Moved | None = None, latched: bool = False) -> None:
        super().__init__(why)
        self.moved = moved
        """How far it went; None: it did not begin."""
        self.latched = latched
        """Whether a fault or an emergency stop is latched."""


Watch: TypeAlias = Callable[[Motion, Snapshot], object]
Canceled: TypeAlias = Callable[[], bool]
Procedure: TypeAlias = Generator[Call | Pause, Any, Moved]


def unwatched(_motion: Motion, _newest: Snapshot) -> None:
    """Do nothing: the default `watch`."""


def never_canceled() -> bool:
    """Return False: the default `canceled`."""
    return False


def goal_of(
    axis: str, distance_u: float, velocity_u_s: float | None, tolerance_u: float | None,
    timeout_s: float | None, direction_rad: float = 0.0,
) -> Goal:  # fmt: skip
    """Make a goal; None stands for the robot's own value. Raises ValueError for a 0, which a Goal
    would take for None."""
    given = (("speed", velocity_u_s), ("tolerance", tolerance_u), ("time-out", timeout_s))
    for name, value in given:
        if value is not None and not value > 0.0:
            raise ValueError(f"the {name} has to be more than 0, not {value:g}")
    return Goal(
        axis="linear" if axis == "linear" else "angular",
        distance_u=distance_u,
        velocity_u_s=velocity_u_s or 0.0,
        tolerance_u=tolerance_u or 0.0,
        timeout_s=timeout_s or 0.0,
        direction_rad=direction_rad,
    )


def procedure(
    goal: Goal,
    *,
    owner: Mapping[str, str],
    daemon_uid: int | None = None,
    watch: Watch = unwatched,
    canceled: Canceled = never_canceled,
) -> Procedure:
    """Carry out a goal. `owner`: the `owner` parameter of `drive`, empty for the default lease; the
    driver releases the lease in the end. `daemon_uid`: the user whose state page is read. `watch`
    is called at each look; when `canceled` returns true the robot comes to rest and the motion
    ends. Raises ValueError for a goal that is not possible, MoveFailed and ClientError."""
    names = limit_names(goal)
    if goal.strafes and not (yield Call("robot")).get("strafes"):
        raise MoveFailed(CANNOT_STRAFE)
    plan = planned(goal, bounds_of(goal, (yield Call("params.get", {"names": names}))))
    begin_s = time.monotonic()
    before = yield Call("status")
    try:
        with StatePage.open(before["robot"], owner=daemon_uid) as page:
            start = _start(page)
            lease = yield from _lease(owner)
            motion = Motion(
                plan,
                start,
                time.monotonic_ns(),
                lease=lease,
                stale_s=STALE_S,
                stops=before["stops"],
            )
            step = yield from _follow(motion, start, page, owner, watch, canceled)
    except NoPage as error:
        raise MoveFailed(str(error)) from error
    assert step.end is not None  # _follow returns nothing else
    moved = Moved(
        end=step.end,
        why=step.why,
        distance_m=motion.travel.distance_m,
        angle_rad=motion.travel.angle_rad,
        duration_s=time.monotonic() - begin_s,
    )
    if moved.end is not End.SUCCEEDED:
        state = (yield Call("status"))["state"]
        raise MoveFailed(moved.why, moved=moved, latched=state in _LATCHED)
    return moved


def _start(page: StatePage) -> Snapshot:
    """Return the snapshot at which the motion begins. Raises MoveFailed if it may not begin."""
    start = page.read()
    if start is None:
        raise MoveFailed("there is no state yet")
    why = problem(start, time.monotonic_ns(), STALE_S) or obstacle(start)
    if why is not None:
        raise MoveFailed(why, latched=bool(start.faults))
    return start


def _lease(owner: Mapping[str, str]) -> Generator[Call | Pause, Any, int]:
    """Send a command of zero and return the number of its lease. Raises MoveFailed if another lease
    is in command."""
    answer = yield Call("drive", {"linear_m_s": 0.0, "angular_rad_s": 0.0, **owner})
    if not answer["in_command"]:
        raise MoveFailed(f"{answer['owner']} is in command")
    return int(answer["number"])


def _follow(
    motion: Motion,
    newest: Snapshot,
    page: StatePage,
    owner: Mapping[str, str],
    watch: Watch,
    canceled: Canceled,
) -> Generator[Call | Pause, Any, MotionStep]:
    due_s = count_s = time.monotonic()
    while True:
        if time.monotonic() >= count_s:
            asked_ns, count_s = time.monotonic_ns(), time.monotonic() + STOPS_EVERY_S
            motion.counted((yield Call("status"))["stops"], asked_ns)
        newest = page.read() or newest
        if canceled():
            motion.cancel(time.monotonic_ns())
        step = motion.step(newest, time.monotonic_ns())
        command = {"linear_m_s": step.linear_m_s, "angular_rad_s": step.angular_rad_s}
        if step.lateral_m_s != 0.0:
            command["lateral_m_s"] = step.lateral_m_s
        try:
            yield Call("drive", {**command, **owner})
        except Refused as error:
            why = obstacle(page.read() or newest) or str(error)
            return step if step.end else MotionStep(end=End.ABORTED, why=why)
        if step.end is not None:
            return step
        watch(motion, newest)
        due_s = max(due_s + LOOK_EVERY_S, time.monotonic())
        yield Pause(due_s)
