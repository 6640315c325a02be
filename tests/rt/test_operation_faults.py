# SPDX-License-Identifier: Apache-2.0
"""What the daemon says of a latched fault, over the real loop."""

import pytest
from small_base import core_config, hear_wheels, settings, until

from motord import rt
from motord.config import load_robot
from motord.machine import Event, State
from motord.operation import Operation
from motord.sdnotify import Notifier
from motord_hal.paths import config_dir
from motord_hal.ports import EventKind, LineEvent

OFF = "left (unit 1) is not enabled any more: set up again, disarmed"
OVER_CURRENT = "left: fault: over-current"


@pytest.fixture
def operation():
    robot = load_robot(config_dir() / "robots" / "demo.toml")
    with rt.Loop(core_config(), settings()) as loop:
        operation = Operation(robot, loop, Notifier({}))
        hear_wheels()
        until(lambda: operation.look() or not operation.facts().stale_joints)
        for event in (Event.START, Event.READY, Event.ARM):
            operation.take(event)
        yield operation


def say(operation, kind, text):
    operation.on_line_event(LineEvent(kind, "rs485", ("left",), text))


def test_a_drive_that_says_why_only_after_it_was_seen_to_be_off_is_named_too(operation):
    operation.fault(OFF)
    assert operation.state is State.FAULT
    say(operation, EventKind.DRIVE_FAULT, OVER_CURRENT)
    assert operation.why == (OFF, OVER_CURRENT)


def test_a_reason_that_is_given_already_is_not_given_again(operation):
    operation.fault(OFF)
    for _ in range(2):
        say(operation, EventKind.DRIVE_FAULT, OVER_CURRENT)
    say(operation, EventKind.DRIVE_WARNING, "left: warning: warm")
    assert operation.why == (OFF, OVER_CURRENT)


def test_a_drive_fault_without_a_latched_fault_is_no_reason_for_one(operation):
    say(operation, EventKind.DRIVE_FAULT, OVER_CURRENT)
    assert operation.state is State.ARMED
    assert operation.why == ()
