# SPDX-License-Identifier: Apache-2.0
"""A joystick moves the robot only while its dead-man button is held."""

import os
import stat
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.sim.daemon_stage import DEADLINE_S, running, wait_until

from motord.bus.joystick.axes import EV_ABS, EV_KEY, EV_SYN, REPEATED, SYN_DROPPED, Codes, Stick
from motord.config import JoystickInput

evdev = pytest.importorskip("evdev")
BUTTON, Y, X = evdev.ecodes.BTN_TL, evdev.ecodes.ABS_Y, evdev.ecodes.ABS_X
SECTION = JoystickInput(kind="joystick", device="pad", linear_m_s=0.5, angular_rad_s=2.0)
UINPUT = Path("/dev/uinput")


def stick(low=-32768, high=32767):
    return Stick(SECTION, Codes(BUTTON, Y, X), {Y: (low, high), X: (low, high)})


def test_nothing_moves_before_the_button_is_pressed():
    pad = stick()
    pad.take(EV_ABS, Y, -32768)
    assert pad.twist() == (0.0, 0.0, 0.0)
    pad.take(EV_KEY, BUTTON, 1)
    assert pad.twist() == (0.5, 0.0, 0.0)


def test_a_released_button_is_zero_whatever_the_axes_report():
    pad = stick()
    pad.take(EV_KEY, BUTTON, 1)
    pad.take(EV_ABS, X, 32767)
    assert pad.twist() == (0.0, -2.0, 0.0)
    pad.take(EV_KEY, BUTTON, 0)
    assert (pad.held, pad.twist()) == (False, (0.0, 0.0, 0.0))


def test_lost_events_release_the_button_and_the_axes():
    pad = stick()
    pad.take(EV_KEY, BUTTON, 1)
    pad.take(EV_ABS, Y, -32768)
    pad.take(EV_SYN, SYN_DROPPED, 0)
    assert (pad.held, pad.twist()) == (False, (0.0, 0.0, 0.0))
    pad.take(EV_KEY, BUTTON, 1)
    assert pad.twist() == (0.0, 0.0, 0.0)


ESTOP = evdev.ecodes.BTN_EAST


def with_estop():
    return Stick(SECTION, Codes(BUTTON, Y, X, ESTOP), {Y: (-1, 1), X: (-1, 1)})


def test_the_emergency_stop_works_whether_or_not_the_dead_man_button_is_held():
    pad = with_estop()
    assert pad.take(EV_KEY, ESTOP, 1)
    assert not pad.take(EV_KEY, ESTOP, 0)
    assert not pad.take(EV_KEY, BUTTON, 1)
    assert pad.take(EV_KEY, ESTOP, 1)
    assert not stick().take(EV_KEY, ESTOP, 1), "this one has no such button"


def test_a_button_that_is_held_and_repeats_counts_neither_as_pressed_nor_as_released():
    pad = with_estop()
    pad.take(EV_KEY, BUTTON, REPEATED)
    assert not pad.held
    pad.take(EV_KEY, BUTTON, 1)
    pad.let_go()  # as after a pause
    pad.take(EV_KEY, BUTTON, REPEATED)
    assert not pad.held
    assert not pad.take(EV_KEY, ESTOP, REPEATED)


def test_lost_events_may_have_been_an_emergency_stop():
    pad = with_estop()
    assert not pad.doubted
    pad.take(EV_SYN, SYN_DROPPED, 0)
    assert pad.doubted


def test_after_a_pause_button_and_axes_count_as_released():
    pad = stick()
    pad.take(EV_KEY, BUTTON, 1)
    pad.take(EV_ABS, Y, -32768)
    pad.let_go()
    assert (pad.held, pad.twist()) == (False, (0.0, 0.0, 0.0))
    pad.take(EV_KEY, BUTTON, 1)
    assert pad.twist() == (0.0, 0.0, 0.0)


@given(
    events=st.lists(
        st.tuples(st.integers(0, 5), st.sampled_from([BUTTON, X, Y, 3, 77]),
                  st.integers(-(2**31), 2**31 - 1))
    ),
    low=st.integers(-40000, 0),
    width=st.integers(1, 70000),
)  # fmt: skip
def test_whatever_comes_the_twist_is_within_its_limits(events, low, width):
    pad = stick(low, low + width)
    for event in events:
        pad.take(*event)
    linear_m_s, angular_rad_s, lateral_m_s = pad.twist()
    assert lateral_m_s == 0.0
    assert abs(linear_m_s) <= 0.5
    assert abs(angular_rad_s) <= 2.0
    assert pad.held or (linear_m_s, angular_rad_s) == (0.0, 0.0)


@given(value=st.integers(-3276, 3276))
def test_the_middle_is_zero(value):
    pad = stick()
    pad.take(EV_KEY, BUTTON, 1)
    pad.take(EV_ABS, Y, value)
    assert pad.twist() == (0.0, 0.0, 0.0)


def test_an_axis_that_the_device_lacks_is_reported():
    with pytest.raises(ValueError, match="no axis"):
        Stick(SECTION, Codes(BUTTON, Y, X), {Y: (0, 255)})


@pytest.mark.skipif(
    not (UINPUT.exists() and stat.S_ISCHR(UINPUT.stat().st_mode) and os.access(UINPUT, os.W_OK)),
    reason="needs /dev/uinput (modprobe uinput; root)",
)
def test_a_kernel_device_drives_and_hands_back_its_lease(tmp_path):
    axis = evdev.AbsInfo(value=0, min=-100, max=100, fuzz=0, flat=0, resolution=0)
    events = {EV_KEY: [BUTTON, ESTOP], EV_ABS: [(X, axis), (Y, axis)]}
    name = f"motord test pad {time.monotonic_ns()}"
    with evdev.UInput(events, name=name) as pad:
        settings = ("input.pad.kind=joystick", f"input.pad.device={name}",
                    "input.pad.estop_button=BTN_EAST")  # fmt: skip
        with running(tmp_path, *settings) as stage:
            stage.wait_for("idle")
            wait_until(lambda: f"input.pad: {name}" in stage.logged(), stage.logged(), DEADLINE_S)
            stage.robot.arm()
            pad.write(EV_ABS, Y, -100)
            pad.write(EV_KEY, BUTTON, 1)
            pad.syn()
            stage.wait_for("moving")
            pad.write(EV_KEY, BUTTON, 0)
            pad.syn()
            stage.wait_for("armed")
            wait_until(lambda: stage.robot.status()["leases"] == [], "handed back")
            pad.write(EV_KEY, ESTOP, 1)
            pad.syn()
            stage.wait_for("estop")
