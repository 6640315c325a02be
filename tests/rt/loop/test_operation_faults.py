# SPDX-License-Identifier: Apache-2.0
"""Reports of the daemon about a latched fault, over the real loop."""

import asyncio
from dataclasses import replace

import pytest
from tests.rt.small_base import core_config, report_wheels, settings, until

from motord.base.log import process_name
from motord.base.sdnotify import Notifier
from motord.config import load_robot
from motord.control.machine import Event, State
from motord.control.operation import Operation
from motord.daemon import procedures
from motord.local_socket.server import Refused
from motord.realtime import loop as rt
from motord_hal.base.paths import config_dir
from motord_hal.fieldbus.ports import EventKind, LineEvent, LineState

OFF = "left (unit 1) is not enabled any more: set up again, disarmed"
OVER_CURRENT = "left: fault: over-current"


@pytest.fixture
def operation(request):
    robot = load_robot(config_dir() / "robots" / "demo.toml")
    on_fault = getattr(request, "param", rt.StopAction.RAMP)
    with rt.Loop(rt.CoreConfig(**{**core_config(), "on_fault": on_fault}), settings()) as loop:
        operation = Operation(robot, loop, Notifier({}))
        report_wheels()
        until(lambda: operation.look() or not operation.facts().stale_joints)
        for event in (Event.START, Event.READY, Event.ARM):
            operation.take(event)
        yield operation


def say(operation, kind, text):
    operation.on_line_event(LineEvent(kind, "rs485", ("left",), text))


def test_the_cause_that_a_drive_reports_after_it_was_seen_off_is_added(operation):
    operation.fault(OFF)
    assert operation.state is State.FAULT
    say(operation, EventKind.DRIVE_FAULT, OVER_CURRENT)
    assert operation.why == (OFF, OVER_CURRENT)


def test_a_reason_is_not_listed_twice(operation):
    operation.fault(OFF)
    for _ in range(2):
        say(operation, EventKind.DRIVE_FAULT, OVER_CURRENT)
    say(operation, EventKind.DRIVE_WARNING, "left: warning: warm")
    assert operation.why == (OFF, OVER_CURRENT)


def test_a_drive_fault_without_a_latched_fault_is_not_a_reason(operation):
    say(operation, EventKind.DRIVE_FAULT, OVER_CURRENT)
    assert operation.state is State.ARMED
    assert operation.why == ()


def test_a_stop_is_over_only_when_the_loop_has_seen_it(operation):
    """The loop's newest state may be from before the stop request, with a robot at rest."""
    operation.take(Event.STOP)
    assert operation.snapshot.at_rest
    operation.loop.read_state = lambda: operation.snapshot
    operation.look()
    assert operation.state is State.STOPPING
    del operation.loop.read_state
    until(lambda: operation.look() or operation.state is State.ARMED)


def test_the_reason_of_an_emergency_stop_replaces_the_core_s_plain_estop(operation):
    """The loop reads the request; asyncio may see the loop's next state before the request."""
    seen = replace(operation.snapshot, faults=("estop",))
    operation.loop.read_state = lambda: seen
    operation.look()
    assert (operation.state, operation.why) == (State.ESTOP, ("estop",))
    operation.estop(1)
    assert operation.why == (f"requested by {process_name(1)}",)
    operation.estop(1, "the panel")
    assert operation.why == (f"the panel ({process_name(1)})",)


def ticks(operation, count):
    last = operation.snapshot.tick + count
    until(lambda: operation.look() or operation.snapshot.tick > last)


async def looking(operation, procedure):
    """Return the result of `procedure`; process the newest state while it runs."""
    running = asyncio.ensure_future(procedure)
    while not running.done():
        operation.look()
        await asyncio.sleep(0)
    return await running


class LineWithAPanel:
    """A line on which a person presses the emergency stop while faults are cleared."""

    state, drive_states, drive_faults = LineState.READY, {}, {}

    def __init__(self, operation):
        self.operation = operation

    async def clear_faults(self):
        self.operation.estop(1, "the panel")


async def test_a_reset_does_not_take_back_an_emergency_stop_that_came_meanwhile(operation):
    operation.fault(OFF)
    operation.lines.append(LineWithAPanel(operation))
    with pytest.raises(Refused, match="meanwhile"):
        await procedures.reset(operation)
    assert operation.state is State.ESTOP
    until(lambda: operation.look() or "estop" in operation.snapshot.faults)


@pytest.mark.parametrize("operation", [rt.StopAction.HOLD], indirect=True)
async def test_a_disarm_ends_a_hold_and_an_arming_afterwards_holds_again(operation):
    for _ in range(2):
        operation.set_armed(True)
        until(lambda: operation.loop.read_state().armed)
        operation.fault(OFF)
        until(lambda: operation.look() or operation.snapshot.faults)
        ticks(operation, 20)
        assert operation.snapshot.enabled
        assert await looking(operation, procedures.disarm(operation)) is State.FAULT
        until(lambda: operation.look() or not operation.snapshot.enabled)
        await looking(operation, procedures.reset(operation))
        operation.take(Event.ARM)
