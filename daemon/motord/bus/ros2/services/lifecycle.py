# SPDX-License-Identifier: Apache-2.0
"""The state machine as that of a managed node (design.ros2.org, "Managed nodes"): inactive is
disarmed, active is armed. A fault or an emergency stop is an error, from which no transition leads:
managers request transitions by themselves, but only a person may reset a latch.

The daemon makes its drives ready by itself, so the node is inactive before any request; `configure`
is accepted there too, because managers begin with it. `cleanup` and `shutdown` lead to states of
the node alone: `cleanup` makes the node of a disarmed robot unconfigured, and after `shutdown`,
which disarms the robot, no transition is possible.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Mapping
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from motord.api.deadline import within
from motord.api.snapshot import stop_answer
from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.gate import CommandGate, NotTaken
from motord.bus.messages.sources import state_name
from motord.bus.ros2.nodes import Node
from motord.client import ClientError

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

# lifecycle_msgs/msg/State and Transition
UNKNOWN = (0, "unknown")
UNCONFIGURED = (1, "unconfigured")
INACTIVE = (2, "inactive")
ACTIVE = (3, "active")
FINALIZED = (4, "finalized")
CONFIGURING = (10, "configuring")
ERROR = (15, "errorprocessing")
_STATES = (UNKNOWN, UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED, CONFIGURING, ERROR)
_DISARMED = (UNCONFIGURED, CONFIGURING, INACTIVE)
_OF_MACHINE = {
    "off": UNCONFIGURED,
    "configuring": CONFIGURING,
    "idle": INACTIVE,
    "armed": ACTIVE,
    "moving": ACTIVE,
    "stopping": ACTIVE,
    "fault": ERROR,
    "estop": ERROR,
}
_CONFIGURE = (1, "configure")
_TRANSITIONS = (
    (*_CONFIGURE, UNCONFIGURED, INACTIVE, None),
    (*_CONFIGURE, INACTIVE, INACTIVE, None),
    (2, "cleanup", INACTIVE, UNCONFIGURED, None),
    (3, "activate", INACTIVE, ACTIVE, "arm"),
    (4, "deactivate", ACTIVE, INACTIVE, "disarm"),
    (5, "shutdown", UNCONFIGURED, FINALIZED, "disarm"),
    (6, "shutdown", INACTIVE, FINALIZED, "disarm"),
    (7, "shutdown", ACTIVE, FINALIZED, "disarm"),
)
"""Number, label, start, goal, and the daemon's method that is called (None: no call)."""
_SUCCEEDED, _FAILED = (97, "transition_success"), (99, "transition_error")
"""Numbers and labels of transitions that cannot be requested: TRANSITION_CALLBACK_* and
rcl_lifecycle's labels."""
LOOK_EVERY_S = 0.1
SEEN_WITHIN_S = 1.0
"""The state page shows within this time what the daemon has answered."""
_SEEN_EVERY_S = 0.01

_log = logging.getLogger(__name__)


class Lifecycle:
    def __init__(self, runtime: Runtime, gate: CommandGate) -> None:
        self._runtime = runtime
        self._gate = gate
        self._voice = RateLimitedLog(_log)
        self._held: tuple[int, str] | None = None
        """UNCONFIGURED or FINALIZED after a request for it; None: the node has the state of the
        machine."""
        self._sent = UNKNOWN

    def serve(self, node: Node) -> None:
        """Offer the services and the topic that `ros2 lifecycle` uses. Raises DdsError."""
        package = "lifecycle_msgs/srv"
        node.serve("~/get_state", f"{package}/GetState", self._get)
        node.serve("~/change_state", f"{package}/ChangeState", self._change)
        node.serve("~/get_available_states", f"{package}/GetAvailableStates", self._states)
        kind = f"{package}/GetAvailableTransitions"
        node.serve("~/get_available_transitions", kind, self._available)
        node.serve("~/get_transition_graph", kind, self._graph)
        self._events = node.publisher("~/transition_event", "lifecycle_msgs/msg/TransitionEvent")

    async def run(self) -> None:
        """Publish each change of the state, until cancelled."""
        while True:
            self._look()
            await asyncio.sleep(LOOK_EVERY_S)

    def _look(self) -> tuple[int, str]:
        """Return the state now, and publish it if it is new."""
        before, self._sent = self._sent, self._now()
        if self._sent != before and UNKNOWN not in (self._sent, before):
            self._events.publish(_event(before, self._sent, _between(before, self._sent)))
        return self._sent

    def _now(self) -> tuple[int, str]:
        """Return the state by the newest view, which is up to LOOK_MAX_S old."""
        if self._held == FINALIZED:
            return FINALIZED
        return self._of(self._machine())

    async def _at_the_daemon(self) -> tuple[int, str]:
        """Return the state by the daemon's own answer, and let the view follow it: a client that
        has just got an answer of the daemon counts on it. UNKNOWN: the daemon does not answer."""
        if self._held == FINALIZED:
            return FINALIZED
        try:
            state = str((await self._runtime.call("status"))["state"])
        except ClientError:
            return UNKNOWN
        machine = _OF_MACHINE.get(state, UNKNOWN)
        await self._view_shows(machine)
        self._look()
        return self._of(machine)

    async def _view_shows(self, *machine: tuple[int, str]) -> None:
        """Wait until the view shows one of these states, for SEEN_WITHIN_S at most."""
        with contextlib.suppress(TimeoutError):
            async with within(SEEN_WITHIN_S):
                while self._machine() not in machine:  # noqa: ASYNC110  the view has no event
                    await asyncio.sleep(_SEEN_EVERY_S)

    def _machine(self) -> tuple[int, str]:
        """Return the state of the machine by the newest view."""
        view = self._runtime.view
        return UNKNOWN if view is None else _OF_MACHINE.get(state_name(view.snapshot), UNKNOWN)

    def _of(self, machine: tuple[int, str]) -> tuple[int, str]:
        """Return the node's state for a state of the machine."""
        if machine == ACTIVE:
            self._held = None  # another client has armed the robot
        return self._held if self._held and machine == INACTIVE else machine

    async def _get(self, _: SimpleNamespace) -> SimpleNamespace:
        return SimpleNamespace(current_state=_pair(*await self._at_the_daemon()))

    async def _states(self, _: SimpleNamespace) -> SimpleNamespace:
        return SimpleNamespace(available_states=[_pair(*state) for state in _STATES])

    async def _available(self, _: SimpleNamespace) -> SimpleNamespace:
        return _described(await self._at_the_daemon())

    async def _graph(self, _: SimpleNamespace) -> SimpleNamespace:
        return _described(None)

    async def _change(self, request: SimpleNamespace) -> SimpleNamespace:
        wanted, now = request.transition, await self._at_the_daemon()
        for number, label, start, goal, method in _TRANSITIONS:
            asked = wanted.id == number if wanted.id else wanted.label == label
            if asked and start == now:
                try:
                    success = await self._walk(goal, method)
                except NotTaken as error:
                    self._voice.say(f"lifecycle: {label}: {error}")
                    success = False
                self._look()
                return SimpleNamespace(success=success)
        self._voice.say(f"lifecycle: no transition {wanted.label or wanted.id!r} from {now[1]}")
        return SimpleNamespace(success=False)

    async def _walk(self, goal: tuple[int, str], method: str | None) -> bool:
        """Carry out a transition; return whether its goal is reached. Raises NotTaken, also for a
        goal at rest while it is unknown whether the robot rests: the drives are disarmed then."""
        if method is None:
            if goal == UNCONFIGURED:
                _at_rest(await self._gate.act("status"))
            return self._hold(goal)
        reached = _DISARMED if goal == FINALIZED else (goal,)
        answer = await self._gate.act(method)
        if _OF_MACHINE.get(answer["state"]) not in reached:
            return False
        await self._view_shows(*reached, ERROR)
        if self._now() == ERROR:
            return False
        if method == "disarm":
            _at_rest(answer)
        if goal == FINALIZED:
            self._held = FINALIZED
        return True

    def _hold(self, goal: tuple[int, str]) -> bool:
        """Make the node unconfigured, or no longer; return whether it is in the state `goal`."""
        if goal == UNCONFIGURED:
            self._held = UNCONFIGURED
        else:
            self._held = None
            if self._now() == goal:
                self._events.publish(_event(self._sent, CONFIGURING, _CONFIGURE))
                self._sent = CONFIGURING
        return self._now() == goal


def _at_rest(answer: Mapping[str, Any]) -> None:
    """Raise NotTaken if it is unknown in an answer of the daemon whether the robot rests."""
    found, text = stop_answer("disarm", answer)
    if not found:
        raise NotTaken(text)


def _between(before: tuple[int, str], now: tuple[int, str]) -> tuple[int, str]:
    """Return the transition between two states, whatever its cause."""
    for number, label, start, goal, _ in _TRANSITIONS:
        if (start, goal) == (before, now):
            return number, label
    return _FAILED if now == ERROR else _SUCCEEDED


def _event(
    before: tuple[int, str], now: tuple[int, str], transition: tuple[int, str]
) -> SimpleNamespace:
    """Return a lifecycle_msgs/TransitionEvent with the current time."""
    return SimpleNamespace(
        timestamp=time.time_ns(),
        transition=_pair(*transition),
        start_state=_pair(*before),
        goal_state=_pair(*now),
    )


def _pair(number: int, label: str) -> SimpleNamespace:
    return SimpleNamespace(id=number, label=label)


def _described(start_at: tuple[int, str] | None) -> SimpleNamespace:
    """Return the transitions that start at a state; None: all transitions."""
    found = [
        SimpleNamespace(
            transition=_pair(number, label), start_state=_pair(*start), goal_state=_pair(*goal)
        )
        for number, label, start, goal, _ in _TRANSITIONS
        if start_at in (None, start)
    ]
    return SimpleNamespace(available_transitions=found)
