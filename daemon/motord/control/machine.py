# SPDX-License-Identifier: Apache-2.0
"""The daemon's state machine: a table, two guards and one pure function.

This module moves nothing. The caller does what an event stands for and then takes the step, so that
a state is only shown when it is true."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass

from motord.api.snapshot import Rest


class State(enum.StrEnum):
    """States of the daemon in the order of their numbers on the state page: append, never
    insert."""

    OFF = "off"
    CONFIGURING = "configuring"
    IDLE = "idle"
    ARMED = "armed"
    MOVING = "moving"
    STOPPING = "stopping"
    FAULT = "fault"
    ESTOP = "estop"

    @property
    def number(self) -> int:
        """Number of the state on the state page."""
        return tuple(State).index(self)

    @property
    def live(self) -> bool:
        """Whether the drives are under power because a client armed."""
        return self in (State.ARMED, State.MOVING, State.STOPPING)


class Event(enum.StrEnum):
    """Events: requests of clients (ARM to SHUTDOWN), and what the daemon observes (from START
    on)."""

    ARM = "arm"
    """Every drive is enabled and the core has armed."""
    DISARM = "disarm"
    """Come to rest, then take the power off."""
    STOP = "stop"
    """Come to rest, and stay armed."""
    ESTOP = "estop"
    RESET = "reset"
    SHUTDOWN = "shutdown"
    """The drives are off and the loop ends."""
    START = "start"
    """The loop runs, and the lines are being opened."""
    READY = "ready"
    """Every line has configured every drive."""
    LOST = "lost"
    """A line or a drive is not ready any more."""
    MOVED = "moved"
    """A set-point or a wheel moves, or it is unknown whether one does."""
    RESTED = "rested"
    """The robot was seen at rest."""
    STOPPED = "stopped"
    """The robot was seen at rest after STOP."""
    DISARMED = "disarmed"
    """The power is off."""
    FAULT = "fault"
    """The core has latched a fault, or a live line was lost."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why an event may not happen, and what to do about it: one sentence for a person."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """Facts by which the guards of ARM and RESET decide."""

    unready_lines: tuple[str, ...] = ()
    stale_joints: tuple[str, ...] = ()
    lost_positions: tuple[str, ...] = ()
    """Joints that take positions, but whose position is not known."""
    drive_faults: tuple[str, ...] = ()
    """`joint: fault words` for each joint whose drive reports a fault."""
    commanding: str | None = None
    """Owner of a lease that requests motion; None: no lease does."""
    rest: str = Rest.AT_REST
    estop_input: str = ""
    """Why the emergency stop's contact stops the robot now; empty: it does not."""
    battery_forbids: bool = False
    """Whether the battery is critical and the robot file forbids driving then."""


_SAME = {state: state for state in State}
_LIVE_TO_STOPPING = {state: State.STOPPING for state in State if state.live}
_NOT_OFF = "the daemon is not running yet"
_CONFIGURING = "the drives are not ready yet: motord status shows which line is waiting for what"
_LATCHED = "a fault is latched: look at motord status, remove the cause, then motord reset"
_ESTOPPED = "the emergency stop is latched: see that it is safe, then motord reset"

_Row = Mapping[State, State | Refusal]
_ROWS: dict[Event, _Row] = {
    Event.ARM: {
        State.OFF: Refusal(_NOT_OFF),
        State.CONFIGURING: Refusal(_CONFIGURING),
        State.IDLE: State.ARMED,
        State.ARMED: State.ARMED,
        State.MOVING: State.MOVING,
        State.STOPPING: Refusal("the robot is stopping: wait until it is at rest"),
        State.FAULT: Refusal(_LATCHED),
        State.ESTOP: Refusal(_ESTOPPED),
    },
    Event.DISARM: _SAME | _LIVE_TO_STOPPING,
    Event.STOP: _SAME | _LIVE_TO_STOPPING,
    Event.ESTOP: dict.fromkeys(State, State.ESTOP),
    Event.RESET: {
        State.OFF: Refusal(_NOT_OFF),
        State.CONFIGURING: Refusal(_CONFIGURING),
        State.IDLE: State.IDLE,
        State.ARMED: Refusal("nothing is latched, and the robot is armed: disarm it first"),
        State.MOVING: Refusal("nothing is latched, and the robot moves: stop and disarm first"),
        State.STOPPING: Refusal("the robot is stopping: wait until it is at rest"),
        State.FAULT: State.IDLE,
        State.ESTOP: State.IDLE,
    },
    Event.SHUTDOWN: dict.fromkeys(State, State.OFF),
    Event.START: _SAME | {State.OFF: State.CONFIGURING},
    Event.READY: _SAME | {State.CONFIGURING: State.IDLE},
    Event.LOST: _SAME | {State.IDLE: State.CONFIGURING},
    Event.MOVED: _SAME | {State.ARMED: State.MOVING},
    Event.RESTED: _SAME | {State.MOVING: State.ARMED},
    Event.STOPPED: _SAME | {State.STOPPING: State.ARMED},
    Event.DISARMED: _SAME | {state: State.IDLE for state in State if state.live},
    Event.FAULT: dict.fromkeys(State, State.FAULT) | {State.ESTOP: State.ESTOP},
}
# For every pair of state and event: the next state, or why it may not happen.
TABLE: dict[tuple[State, Event], State | Refusal] = {
    (state, event): target for event, row in _ROWS.items() for state, target in row.items()
}


def step(state: State, event: Event, facts: Facts) -> State | Refusal:
    """Return the state to which `event` leads from `state`, or why it may not happen. Pure."""
    target = TABLE[state, event]
    if isinstance(target, Refusal):
        return target
    if event is Event.ARM and target is not state:
        return _arm_refusal(facts) or target
    if event is Event.RESET:
        return _reset_refusal(facts) or target
    return target


def _arm_refusal(facts: Facts) -> Refusal | None:
    """Return why the robot may not be armed; None: it may."""
    if facts.drive_faults:
        return Refusal(f"a drive reports a fault ({_list(facts.drive_faults)}): motord reset")
    if facts.battery_forbids:
        return Refusal("the battery is critical: charge it (safety.on_battery_critical)")
    return _presence_refusal(facts) or _command_refusal(facts)


def _reset_refusal(facts: Facts) -> Refusal | None:
    """Return why a reset may not happen; None: it may. A drive's own fault does not prevent a
    reset, which clears it."""
    if facts.estop_input:
        return Refusal(facts.estop_input)
    if facts.rest == Rest.TURNING:  # unknown: feedback is missing, or the reset trusts it again
        return Refusal("the wheels still turn: wait until the robot is at rest")
    return _presence_refusal(facts) or _command_refusal(facts)


def _presence_refusal(facts: Facts) -> Refusal | None:
    if facts.unready_lines:
        lines = _list(facts.unready_lines)
        return Refusal(f"not ready: {lines}; look at cable, power and port, then try again")
    if facts.stale_joints:
        joints = _list(facts.stale_joints)
        return Refusal(f"no fresh feedback of {joints}; look at cable and power, then try again")
    if facts.lost_positions:
        joints = _list(facts.lost_positions)
        return Refusal(f"where {joints} stands is not known; home it, then try again")
    return None


def _command_refusal(facts: Facts) -> Refusal | None:
    if facts.commanding is not None:
        return Refusal(f"{facts.commanding} requests motion: it must send zero, or end, first")
    return None


def _list(words: tuple[str, ...]) -> str:
    return ", ".join(words)
