# SPDX-License-Identifier: Apache-2.0
"""The server of a ROS 2 action: services for goals, cancelling and results, and topics for feedback
and the goals' states (design.ros2.org, "Actions"; rcl_action). It does not know what a goal does.

Actions that take turns share a Turn: a new goal is refused while another one is running.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import re
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from enum import IntEnum
from types import SimpleNamespace

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.ros2.nodes import Node
from motord.bus.ros2.quality import Quality

GOALS_KEPT = 16
"""Number of goals that are kept with their results; the oldest are forgotten first."""
RESULTS_TOGETHER = 8
"""Largest number of clients that wait for results at once."""
RESULTS_DEPTH = 100
"""Depth of the service for results. All clients that wait for one result are answered at once: the
default of 10 loses answers."""
FEEDBACK_EVERY_S = 0.1
STATUS = Quality(depth=1, latched=True)
"""Quality of service of the status topic: rcl_action_qos_profile_status_default."""

_log = logging.getLogger(__name__)


class Status(IntEnum):
    """State of a goal: action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


ENDED = (Status.SUCCEEDED, Status.CANCELED, Status.ABORTED)


class Refused(Exception):
    """A goal is not taken; the text is the reason."""


# action_msgs/srv/CancelGoal
_NO_ERROR, _UNKNOWN_GOAL, _GOAL_ENDED = 0, 2, 3
_ANY_ID = bytes(16)
_NUMBER = re.compile(r"[-+.\d]+")
Report = Callable[[SimpleNamespace], None]
Work = Callable[[Report, asyncio.Event], Awaitable[tuple[Status, SimpleNamespace]]]
"""Function that carries out a goal. It sends feedback, checks whether it is cancelled, and does not
raise."""


class Turn:
    """Name of the action that is at work, of those that take turns; None while all of them rest."""

    def __init__(self) -> None:
        self.holder: str | None = None


@dataclass(slots=True, kw_only=True)
class _Goal:
    number: bytes
    stamp_ns: int
    work: Work
    status: Status = Status.ACCEPTED
    result: SimpleNamespace | None = None
    alive_s: float = field(default_factory=time.monotonic)
    """When its client last showed that it lives."""
    lapsed: bool = False
    """Whether it was cancelled because its client was silent."""
    cancel: asyncio.Event = field(default_factory=asyncio.Event)
    ended: asyncio.Event = field(default_factory=asyncio.Event)


class ActionServer:
    def __init__(
        self,
        name: str,
        kind: str,
        accept: Callable[[SimpleNamespace], Awaitable[Work]],
        nothing: SimpleNamespace,
        turn: Turn,
        goal_lease_s: float | None = None,
    ) -> None:
        """`kind`: pkg/action/Name. `accept` raises Refused. `nothing`: the result of a goal that is
        unknown or was aborted before it had one. `goal_lease_s`: a goal comes to rest and is
        aborted when its client has been silent for this long (`alive`); None: it goes on without
        its client."""
        self._name, self._kind = name, kind
        self._accept, self._nothing, self._turn = accept, nothing, turn
        self._goal_lease_s = goal_lease_s
        self._goals: dict[bytes, _Goal] = {}
        self._next: asyncio.Queue[_Goal] = asyncio.Queue(1)
        self._voices: dict[str, RateLimitedLog] = {}

    def serve(self, node: Node) -> None:
        """Offer the action on a node. When called again, with another node, abort a goal that was
        accepted and has not begun. Raises DdsError."""
        while not self._next.empty():
            self._abort(self._next.get_nowait())
            self._turn.holder = None
        below = f"{self._name}/_action"
        node.serve(f"{below}/send_goal", f"{self._kind}_SendGoal", self._send)
        node.serve(f"{below}/cancel_goal", "action_msgs/srv/CancelGoal", self._cancel)
        node.serve(
            f"{below}/get_result", f"{self._kind}_GetResult", self._result,
            depth=RESULTS_DEPTH, together=RESULTS_TOGETHER,
        )  # fmt: skip
        self._feedback = node.publisher(f"{below}/feedback", f"{self._kind}_FeedbackMessage")
        self._status = node.publisher(f"{below}/status", "action_msgs/msg/GoalStatusArray", STATUS)

    async def run(self) -> None:
        """Carry out one goal after the other, until cancelled."""
        self._say_status()
        while True:
            goal = await self._next.get()
            try:
                await self._execute(goal)
            finally:
                self._abort(goal)
                self._turn.holder = None

    async def _execute(self, goal: _Goal) -> None:
        if goal.status is Status.ACCEPTED:
            self._become(goal, Status.EXECUTING)
        due_s = 0.0

        def report(feedback: SimpleNamespace) -> None:
            nonlocal due_s
            now_s = time.monotonic()
            self._look_for_client(goal, now_s)
            if now_s >= due_s:
                due_s = now_s + FEEDBACK_EVERY_S
                self._feedback.publish(
                    SimpleNamespace(goal_id=_uuid(goal.number), feedback=feedback)
                )

        status, goal.result = await goal.work(report, goal.cancel)
        if goal.lapsed and status is Status.CANCELED:
            status = Status.ABORTED
            why = f"its client was silent for {self._goal_lease_s:g} s"
            goal.result = SimpleNamespace(**vars(goal.result) | {"message": why})
        self._become(goal, status)
        goal.ended.set()

    def alive(self, number: bytes) -> None:
        """Note that the client of a goal lives."""
        if (goal := self._goals.get(number)) is not None:
            goal.alive_s = time.monotonic()

    def _look_for_client(self, goal: _Goal, now_s: float) -> None:
        """Cancel a goal whose client has been silent for longer than the lease."""
        if self._goal_lease_s is not None and now_s - goal.alive_s > self._goal_lease_s:
            goal.lapsed = goal.lapsed or not goal.cancel.is_set()
            goal.cancel.set()

    def _abort(self, goal: _Goal) -> None:
        """Abort a goal that has not ended; `run` publishes its state when it starts again."""
        if not goal.ended.is_set():
            goal.status, goal.result = Status.ABORTED, self._nothing
            goal.ended.set()

    def _become(self, goal: _Goal, status: Status) -> None:
        goal.status = status
        self._say_status()

    def _say_status(self) -> None:
        sent = [
            SimpleNamespace(goal_info=_info(goal), status=int(goal.status))
            for goal in self._goals.values()
        ]
        self._status.publish(SimpleNamespace(status_list=sent))

    # ----------------------------------------------------------------------------------- services
    async def _send(self, request: SimpleNamespace) -> SimpleNamespace:
        number = bytes(request.goal_id.uuid)
        refused = SimpleNamespace(accepted=False, stamp=_time(0))
        if number in self._goals:
            return self._no(refused, "a goal with this id exists already")
        if self._turn.holder is not None:
            return self._no(refused, f"{self._turn.holder} is running")
        self._turn.holder, work = self._name, None
        try:
            work = await self._accept(request.goal)
        except Refused as error:
            return self._no(refused, str(error))
        finally:
            if work is None:
                self._turn.holder = None
        goal = _Goal(number=number, stamp_ns=time.time_ns(), work=work)
        self._goals[number] = goal
        for old in list(itertools.islice(self._goals, max(0, len(self._goals) - GOALS_KEPT))):
            del self._goals[old]
        self._next.put_nowait(goal)
        self._say_status()
        return SimpleNamespace(accepted=True, stamp=_time(goal.stamp_ns))

    def _no(self, answer: SimpleNamespace, why: str) -> SimpleNamespace:
        """Return `answer`, and log the reason, rate-limited for each reason: the answer cannot hold
        it."""
        reason = _NUMBER.sub("", why)
        voice = self._voices.setdefault(reason, RateLimitedLog(_log))
        voice.say(f"action {self._name}: refused: {why}")
        return answer

    async def _cancel(self, request: SimpleNamespace) -> SimpleNamespace:
        """Cancel the goal with a number, all goals up to a time, or both; with neither, all goals
        (CancelGoal.srv)."""
        info = request.goal_info
        number, until_ns = bytes(info.goal_id.uuid), _nanoseconds(info.stamp)
        everything = number == _ANY_ID and until_ns == 0
        meant = [
            goal
            for goal in self._goals.values()
            if everything or goal.number == number or (until_ns and goal.stamp_ns <= until_ns)
        ]
        found = [goal for goal in meant if goal.status not in ENDED]
        for goal in found:
            goal.cancel.set()
            self._become(goal, Status.CANCELING)
        code = _NO_ERROR
        if not found and number != _ANY_ID:
            code = _GOAL_ENDED if number in self._goals else _UNKNOWN_GOAL
        return SimpleNamespace(return_code=code, goals_canceling=[_info(goal) for goal in found])

    async def _result(self, request: SimpleNamespace) -> SimpleNamespace:
        """Return the result of a goal when the goal has ended; each goal has a time-out of its
        own."""
        goal = self._goals.get(bytes(request.goal_id.uuid))
        if goal is None:
            return SimpleNamespace(status=int(Status.UNKNOWN), result=self._nothing)
        await goal.ended.wait()
        return SimpleNamespace(status=int(goal.status), result=goal.result)


def _uuid(number: bytes) -> SimpleNamespace:
    return SimpleNamespace(uuid=number)


def _info(goal: _Goal) -> SimpleNamespace:
    return SimpleNamespace(goal_id=_uuid(goal.number), stamp=_time(goal.stamp_ns))


def _time(moment_ns: int) -> SimpleNamespace:
    sec, nanosec = divmod(moment_ns, 1_000_000_000)
    return SimpleNamespace(sec=sec, nanosec=nanosec)


def _nanoseconds(stamp: SimpleNamespace) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
