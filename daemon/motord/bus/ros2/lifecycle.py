# SPDX-License-Identifier: Apache-2.0
"""The state machine as that of a managed node (design.ros2.org, "Managed nodes"): inactive is
disarmed, active is armed. A fault or an emergency stop is an error, from which no transition leads:
managers walk transitions by themselves, and a latch is for a person to reset."""

from __future__ import annotations

import asyncio
import logging
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING

from motord.bus.inputs.desk import Desk, NotTaken
from motord.bus.messages import state_name
from motord.bus.ros2.nodes import Node
from motord.sparing import Sparing

if TYPE_CHECKING:
    from motord.bus.station import Station

# lifecycle_msgs/msg/State and Transition
UNKNOWN = (0, "unknown")
UNCONFIGURED = (1, "unconfigured")
INACTIVE = (2, "inactive")
ACTIVE = (3, "active")
CONFIGURING = (10, "configuring")
ERROR = (15, "errorprocessing")
_STATES = (UNKNOWN, UNCONFIGURED, INACTIVE, ACTIVE, CONFIGURING, ERROR)
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
_TRANSITIONS = (
    (3, "activate", INACTIVE, ACTIVE, "arm"),
    (4, "deactivate", ACTIVE, INACTIVE, "disarm"),
)
_SUCCEEDED, _FAILED = (97, "transition_success"), (99, "transition_error")
"""Of transitions that nobody can ask for: TRANSITION_CALLBACK_* and rcl_lifecycle's labels."""
LOOK_EVERY_S = 0.1

_log = logging.getLogger(__name__)


class Lifecycle:
    def __init__(self, station: Station, desk: Desk) -> None:
        self._station = station
        self._desk = desk
        self._voice = Sparing(_log)

    def serve(self, node: Node) -> None:
        """What `ros2 lifecycle` asks for. Raises DdsError."""
        package = "lifecycle_msgs/srv"
        node.serve("~/get_state", f"{package}/GetState", self._get)
        node.serve("~/change_state", f"{package}/ChangeState", self._change)
        node.serve("~/get_available_states", f"{package}/GetAvailableStates", self._states)
        kind = f"{package}/GetAvailableTransitions"
        node.serve("~/get_available_transitions", kind, self._available)
        node.serve("~/get_transition_graph", kind, self._graph)
        self._events = node.publisher("~/transition_event", "lifecycle_msgs/msg/TransitionEvent")

    async def run(self) -> None:
        """Say when the state has changed, until cancelled."""
        before = self._now()
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            now = self._now()
            if now != before and UNKNOWN not in (now, before):
                self._events.publish(_event(before, now))
            before = now

    def _now(self) -> tuple[int, str]:
        view = self._station.view
        return UNKNOWN if view is None else _OF_MACHINE.get(state_name(view.snapshot), UNKNOWN)

    async def _get(self, _: SimpleNamespace) -> SimpleNamespace:
        return SimpleNamespace(current_state=_pair(*self._now()))

    async def _states(self, _: SimpleNamespace) -> SimpleNamespace:
        return SimpleNamespace(available_states=[_pair(*state) for state in _STATES])

    async def _available(self, _: SimpleNamespace) -> SimpleNamespace:
        return _described(self._now())

    async def _graph(self, _: SimpleNamespace) -> SimpleNamespace:
        return _described(None)

    async def _change(self, request: SimpleNamespace) -> SimpleNamespace:
        wanted, now = request.transition, self._now()
        for number, label, start, _, method in _TRANSITIONS:
            asked = wanted.id == number if wanted.id else wanted.label == label
            if asked and start == now:
                try:
                    await self._desk.act(method)
                except NotTaken as error:
                    self._voice.say(f"lifecycle: {label}: {error}")
                    return SimpleNamespace(success=False)
                return SimpleNamespace(success=True)
        self._voice.say(f"lifecycle: no transition {wanted.label or wanted.id!r} from {now[1]}")
        return SimpleNamespace(success=False)


def _event(before: tuple[int, str], now: tuple[int, str]) -> SimpleNamespace:
    """lifecycle_msgs/TransitionEvent, of this moment."""
    transition = _FAILED if now == ERROR else _SUCCEEDED
    for number, label, start, goal, _ in _TRANSITIONS:
        if (start, goal) == (before, now):
            transition = (number, label)
    return SimpleNamespace(
        timestamp=time.time_ns(),
        transition=_pair(*transition),
        start_state=_pair(*before),
        goal_state=_pair(*now),
    )


def _pair(number: int, label: str) -> SimpleNamespace:
    return SimpleNamespace(id=number, label=label)


def _described(start_at: tuple[int, str] | None) -> SimpleNamespace:
    """The transitions from there; None: all."""
    found = [
        SimpleNamespace(
            transition=_pair(number, label), start_state=_pair(*start), goal_state=_pair(*goal)
        )
        for number, label, start, goal, _ in _TRANSITIONS
        if start_at in (None, start)
    ]
    return SimpleNamespace(available_transitions=found)
