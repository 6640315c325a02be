# SPDX-License-Identifier: Apache-2.0
"""A joystick of the kernel (uinput): wheels turn only while its dead-man button is held."""

from pathlib import Path

import evdev
import pytest
from cable import UART, adapter, behind, plug, robot_file
from evdev.ecodes import ABS_X, ABS_Y, BTN_EAST, BTN_TL, EV_ABS, EV_KEY
from shell import wait_until
from stage import daemon, granted

NAME = "motord test pad"
PACKAGES = Path("/usr/lib/motord/lib/python3.11/site-packages")
SECTION = f"""
[input.pad]
kind = "joystick"
device = "{NAME}"
linear_m_s = 0.5
estop_button = "BTN_EAST"
"""


@pytest.fixture
def pad():
    axis = evdev.AbsInfo(value=0, min=-100, max=100, fuzz=0, flat=0, resolution=0)
    events = {EV_KEY: [BTN_TL, BTN_EAST], EV_ABS: [(ABS_X, axis), (ABS_Y, axis)]}
    with evdev.UInput(events, name=NAME) as pad:
        yield pad


@pytest.fixture
def packaged():
    """motord's package, with evdev where `motord check` wants it installed. It looks nowhere
    else: not in PYTHONPATH, and not in the packages of the distribution."""
    link = PACKAGES / "evdev"
    link.symlink_to(Path(evdev.__file__).parent)
    yield
    link.unlink()


@pytest.fixture
def stage(tmp_path, packaged, simulator):
    """A running daemon."""
    plug()
    robot = robot_file(tmp_path, UART)
    robot.write_text(robot.read_text() + SECTION)
    with behind(simulator, adapter()) as sim, daemon(tmp_path, robot, sim) as stage:
        yield stage


def push(pad, *events):
    for event in events:
        pad.write(*event)
    pad.syn()


def turns(stage):
    return not stage.sim.truth().at_rest


def drives(stage, pad):
    """Hold the button, and return whether the wheels turn. If the robot has to be armed, release it
    before: arming is refused while a source requests motion."""
    if not stage.robot.status()["armed"]:
        push(pad, (EV_KEY, BTN_TL, 0))
        stage.armed()
    push(pad, (EV_KEY, BTN_TL, 1))
    return turns(stage)


@pytest.mark.smoke
def test_wheels_turn_while_its_button_is_held_and_its_emergency_stop_latches(pad, stage):
    stage.wait_for("idle")
    wait_until(lambda: f"input.pad: {NAME}" in stage.logged(), "it is found", stage.logged)
    granted(stage.armed, "armed", stage.logged)
    push(pad, (EV_ABS, ABS_Y, -100))
    assert stage.sim.truth().at_rest
    granted(lambda: drives(stage, pad), "the wheels turn", stage.logged)
    push(pad, (EV_KEY, BTN_TL, 0))
    wait_until(lambda: not turns(stage), "the wheels rest", stage.logged)
    granted(lambda: drives(stage, pad), "the wheels turn again", stage.logged)
    push(pad, (EV_KEY, BTN_EAST, 1))
    stage.wait_for("estop")
    wait_until(stage.rests_without_power, "without power", stage.logged)
