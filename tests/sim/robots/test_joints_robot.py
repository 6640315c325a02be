# SPDX-License-Identifier: Apache-2.0
"""A robot without a base on simulated bus servos: its joints go to the commanded positions."""

import json
import math
import re
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, UNHURRIED, rests, running, wait_until

from motord.client import Refused, WrongParams
from motord.config import load_robot

SETTINGS = (
    *UNHURRIED,
    *(f"joint.{name}.{setting}" for name in ("pan", "tilt")
      for setting in ("tries=10", "reply_timeout_s=0.2")),
)  # fmt: skip
NEAR_RAD = 0.03
LEASE_S = 5.0
"""Longest lease; it has to last while a process starts."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    robot = ROOT / "config/robots/pan-tilt.toml"
    with running(tmp_path_factory.mktemp("joints"), *SETTINGS, robot=robot) as stage:
        stage.wait_for("idle")
        yield stage


def true_rad(stage, name):
    return stage.sim.truth().joints[name].position_rad


def command(stage, *words):
    return subprocess.run(
        [sys.executable, "-m", "motord", "joints", *words, "--json", "--socket", str(stage.socket)],
        capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT,
    )  # fmt: skip


def shown(stage):
    """Return what `motord status` prints."""
    words = [sys.executable, "-m", "motord", "status", "--socket", str(stage.socket)]
    return subprocess.run(
        words, capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT, check=True
    ).stdout


def test_motord_joints_ends_at_the_commanded_positions(armed):
    for goal_rad in (0.4, -0.3):
        done = command(armed, f"pan={goal_rad}", f"tilt={goal_rad / 2}")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["arrived"] is True
        assert true_rad(armed, "pan") == pytest.approx(goal_rad, abs=NEAR_RAD)
        assert true_rad(armed, "tilt") == pytest.approx(goal_rad / 2, abs=NEAR_RAD)


def test_a_joint_rests_before_its_target_when_its_commands_end(armed):
    start_rad = true_rad(armed, "pan")
    goal_rad = -1.4 if start_rad > 0.0 else 1.4
    armed.robot.joints({"pan": goal_rad}, lease_s=0.1)
    wait_until(lambda: armed.robot.status()["leases"] == [], "the lease to lapse")
    rests(armed)
    wait_until(lambda: armed.robot.status()["at_rest"], "rest")
    held_rad = true_rad(armed, "pan")
    assert abs(held_rad - goal_rad) > NEAR_RAD
    armed.robot.joints({}, lease_s=0.5)
    assert armed.robot.status()["leases"][0]["joints"] == {}
    wait_until(lambda: armed.robot.status()["leases"] == [], "the lease to lapse")
    assert true_rad(armed, "pan") == pytest.approx(held_rad, abs=0.005)


def test_a_stop_leaves_no_target_behind(armed):
    start_rad = true_rad(armed, "pan")
    goal_rad = -1.4 if start_rad > 0.0 else 1.4
    armed.robot.joints({"pan": goal_rad}, lease_s=0.5)
    armed.robot.stop()
    wait_until(lambda: armed.robot.status()["at_rest"], "rest")
    rests(armed)
    assert abs(true_rad(armed, "pan") - goal_rad) > NEAR_RAD


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda robot: robot.joints({"roll": 0.1}), "there is no joint 'roll'"),
        (lambda robot: robot.joints({}, {"pan": 0.1}), "takes positions"),
        *(
            (
                lambda robot, value=value: robot.joints({"pan": value}),
                r"pan = \S+ is beyond its range, -1.5 to 1.5 rad: .*Check the unit",
            )
            for value in (90.0, 10.0, 1.7, -1.7)
        ),
        (lambda robot: robot.drive(0.1, 0.0), "no base that drives"),
    ],
)
def test_a_command_that_these_joints_cannot_follow_is_refused_with_the_reason(armed, call, why):
    before_rad = true_rad(armed, "pan")
    with pytest.raises(Refused, match=why):
        call(armed.robot)
    assert true_rad(armed, "pan") == pytest.approx(before_rad, abs=0.005)


def test_a_position_before_arming_is_refused_and_moves_nothing(stage):
    stage.wait_for("idle")
    before_rad = true_rad(stage, "tilt")
    with pytest.raises(Refused, match="motord arm"):
        stage.robot.joints({"tilt": 0.5})
    assert true_rad(stage, "tilt") == before_rad


def test_status_names_joints_and_their_angles(armed):
    assert command(armed, "tilt=0.3").returncode == 0
    armed.robot.joints({"tilt": 0.3}, lease_s=LEASE_S)
    status = armed.robot.status()
    assert status["joints"]["tilt"]["position_rad"] == pytest.approx(0.3, abs=NEAR_RAD)
    (lease,) = (one for one in status["leases"] if one["owner"] == "socket")
    assert lease["joints"] == {"tilt": 0.3}
    armed.robot.call("release", owner="socket")
    assert re.search(r"joint tilt +drive armed, at 0\.[23]\d+ rad", shown(armed))
    description = armed.robot.call("robot")
    assert (description["drives"], description["takes_position"]) == (False, ["pan", "tilt"])


def test_status_names_the_joint_that_its_range_limits(armed):
    def named():
        armed.robot.joints({"pan": 5.0}, clamp=True, lease_s=LEASE_S)
        return re.search(r"reasons +.*joint_position of pan for \d", shown(armed))

    wait_until(named, "the reason in the text")
    armed.robot.joints({"pan": 5.0}, clamp=True, lease_s=LEASE_S)
    status = armed.robot.status()
    assert status["limited"]["joint_position"]["joints"] == ["pan"]
    assert status.limited["joint_position"].joints == ("pan",)
    assert status.limited["joint_position"].for_s >= 0.0
    armed.robot.call("release", owner="socket")


PAN_SPEED = "joint.pan.velocity_max_rad_s"


def test_only_limits_that_these_joints_have_are_listed(stage):
    listed = stage.robot.params_list()
    limits = {name for name in listed if not name.startswith("drive.")}
    keys = ("velocity_max_rad_s", "acceleration_max_rad_s2")
    assert limits == {f"joint.{name}.{key}" for name in ("pan", "tilt") for key in keys}
    assert set(stage.robot.params_get()) == limits
    with pytest.raises(WrongParams, match="there is no base"):
        stage.robot.params_set(**{"limits.linear_m_s": 0.1})
    with pytest.raises(WrongParams, match="did you mean"):
        stage.robot.params_set(**{"joint.pan.velocity_max_rad": 0.1})
    with pytest.raises(WrongParams, match="out of range"):
        stage.robot.params_set(**{PAN_SPEED: listed[PAN_SPEED]["maximum"] * 1.01})


@pytest.fixture(name="slowed")
def _slowed(armed):
    """The armed robot with its pan joint limited to 0.3 rad/s; the old limit is restored."""
    before = armed.robot.params_get(PAN_SPEED)
    armed.robot.params_set(**{PAN_SPEED: 0.3})
    yield armed
    armed.robot.params_set(**before)


def test_lowering_a_limit_slows_a_moving_joint(slowed):
    def at_speed(rad_s):
        def seen():
            goal_rad = math.copysign(1.4, goals[-1])
            if abs(true_rad(slowed, "pan") - goal_rad) < NEAR_RAD:
                goals.append(-goal_rad)
            slowed.robot.joints({"pan": goals[-1]}, lease_s=LEASE_S)
            return abs(slowed.robot.status()["joints"]["pan"]["setpoint_rad_s"]) == rad_s

        return seen

    goals = [1.4]
    wait_until(at_speed(0.3), "the first limit")
    assert slowed.robot.params_set(**{PAN_SPEED: 0.1}) == {PAN_SPEED: 0.1}
    wait_until(at_speed(0.1), "the lowered limit")
    slowed.robot.call("release", owner="socket")


def test_limits_of_joints_are_saved(stage, tmp_path):
    file = tmp_path / "head.toml"
    file.write_text((ROOT / "config/robots/pan-tilt.toml").read_text())
    before = stage.robot.params_get(PAN_SPEED)
    stage.robot.params_set(**{PAN_SPEED: 0.7})
    words = ["params", "save", "--file", str(file), "--yes", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "motord", *words, "--socket", str(stage.socket)],
        capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT, check=True,
    )  # fmt: skip
    stage.robot.params_set(**before)
    assert json.loads(done.stdout)["saved"] == {PAN_SPEED: 0.7}
    assert load_robot(file).joint["pan"].velocity_max_rad_s == 0.7
