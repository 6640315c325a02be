# SPDX-License-Identifier: Apache-2.0
"""A robot of joints on a CAN bus: a joint moves only while its drive has its reference position."""

import contextlib

import pytest
from tests.sim.daemon_stage import UNHURRIED, armed, running, wait_until

from motord.client import Refused

ROBOT = """
[robot]
name = "turret"

[base]
kind = "joints"

[line.can0]
kind = "can"
channel = "can0"
bitrate = 1000000
data_bitrate = 5000000
cycle_hz = 50
"""
JOINT = """
[joint.{name}]
line = "can0"
drive = "moteus-position"
unit = {unit}
position_min_rad = -1.5
position_max_rad = 1.5
velocity_max_rad_s = 3.0
acceleration_max_rad_s2 = 20.0
tries = 10
"""
PATIENT = (
    *UNHURRIED, "safety.feedback_timeout_s=3.0", "safety.heartbeat_timeout_s=5.0",
    "safety.drive_watchdog_s=2.0",
)  # fmt: skip
NEAR_RAD = 0.03


@pytest.fixture
def stage(tmp_path):
    robot = tmp_path / "turret.toml"
    joints = (JOINT.format(name=name, unit=unit) for unit, name in enumerate(("pan", "tilt"), 1))
    robot.write_text(ROBOT + "".join(joints), encoding="utf-8")
    with running(tmp_path, *PATIENT, robot=robot) as stage:
        stage.wait_for("idle")
        yield stage


def true_rad(stage, name):
    return stage.sim.truth().joints[name].position_rad


def test_joints_on_can_reach_their_commanded_positions(stage):
    with armed(stage):
        stage.robot.joints({"pan": 0.7, "tilt": -0.4}, lease_s=5.0)
        wait_until(lambda: abs(true_rad(stage, "pan") - 0.7) < NEAR_RAD, "pan is there")
        wait_until(lambda: abs(true_rad(stage, "tilt") + 0.4) < NEAR_RAD, "tilt is there")


def test_a_joint_that_lost_its_reference_is_not_armed_and_does_not_move(stage):
    stage.sim.inject("reboot:unit=2,for_s=0.2")

    def refusal():
        with contextlib.suppress(Refused):
            if stage.state() == "fault":
                stage.robot.reset()
        try:
            stage.robot.arm()
        except Refused as error:
            return "where tilt stands is not known" in str(error)
        stage.robot.disarm()  # the daemon has not noticed the reboot yet
        return False

    assert wait_until(refusal, stage.logged())
    before = true_rad(stage, "pan"), true_rad(stage, "tilt")
    with contextlib.suppress(Refused):
        stage.robot.joints({"pan": 0.7, "tilt": 0.4}, lease_s=1.0)
    wait_until(lambda: stage.robot.status()["leases"] == [], "the lease to lapse")
    assert (true_rad(stage, "pan"), true_rad(stage, "tilt")) == before
