# SPDX-License-Identifier: Apache-2.0
"""The gate that limits how much motion waits in the kernel for a CAN bus that may be dead."""

import pytest

from motord_hal.can.motion_gate import MotionGate

CYCLE_S = 0.01


@pytest.fixture
def gate():
    return MotionGate(CYCLE_S, receives_own=True)


def cycle(gate, at_s, handed, moving=True):
    """Run a cycle; `handed`: frames that the bus takes (+) or refuses (-)."""
    for one in handed:
        gate.handed(taken=one == "+")
    gate.cycle_ended(at_s, moving=moving)


def test_motion_that_does_not_leave_shuts_the_gate_after_a_cycle_until_a_frame_leaves(gate):
    cycle(gate, 1.0, "+")
    assert not gate.is_shut(1.0 + 0.9 * CYCLE_S)
    cycle(gate, 1.009, "+")
    assert gate.is_shut(1.0 + 1.1 * CYCLE_S)
    gate.left()
    assert not gate.is_shut(1.0 + 1.1 * CYCLE_S)


def test_a_bus_that_takes_nothing_for_a_cycle_shuts_the_gate_until_it_takes_a_frame(gate):
    cycle(gate, 1.0, "-+-", moving=False)
    assert not gate.is_shut(1.0)
    cycle(gate, 1.01, "--", moving=False)
    assert gate.is_shut(1.01)
    cycle(gate, 1.02, "", moving=False)
    assert gate.is_shut(1.02)
    gate.handed(taken=True)
    assert not gate.is_shut(1.02)


def test_a_set_point_of_zero_never_shuts_the_gate(gate):
    cycle(gate, 1.0, "+", moving=False)
    assert not gate.is_shut(9.0)


def test_a_fast_line_waits_for_a_slow_adapter():
    gate = MotionGate(0.001, receives_own=True)
    cycle(gate, 1.0, "+")
    assert not gate.is_shut(1.004)
    assert gate.is_shut(1.006)


def test_a_bus_that_was_opened_again_has_an_open_gate(gate):
    cycle(gate, 1.0, "+")
    cycle(gate, 1.01, "-")
    gate.opened()
    assert not gate.is_shut(9.0)


def test_where_nothing_reports_sent_frames_the_gate_stays_open():
    gate = MotionGate(CYCLE_S, receives_own=False)
    cycle(gate, 1.0, "+")
    cycle(gate, 1.01, "-")
    assert not gate.is_shut(9.0)
