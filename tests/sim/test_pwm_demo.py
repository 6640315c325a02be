# SPDX-License-Identifier: Apache-2.0
"""A robot on two bridges at a computer's pins drives the course, as `motord demo --robot
pi5-bts7960` does; and what its wheels do when the daemon is killed."""

import json
import signal
import subprocess
import sys

import pytest
from daemon_stage import DEADLINE_S, ROOT, running, set_off, wait_until

ROBOT = ROOT / "config/robots/pi5-bts7960.toml"
PATIENT = "\n[safety]\nfeedback_timeout_s = 2.0\nheartbeat_timeout_s = 2.0\n"
"""A busy machine is no fault."""
SPEED_RAD_S = 5.0


def test_a_robot_on_pins_drives_the_course_and_knows_where_it_is(tmp_path):
    path = tmp_path / "pi5-bts7960.toml"
    path.write_text(ROBOT.read_text(encoding="utf-8") + PATIENT, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "motord", "demo", "--json", "--seconds", "6", "--robot", path],
        capture_output=True,
        text=True,
        timeout=90,
        cwd=ROOT,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    result = json.loads(run.stdout)
    assert result["ok"] is True
    assert result["engine"] == {"pins": "rt"}
    assert result["odometry"]["distance_m"] > 0.5
    assert result["safety"]["final_state"] == "idle"


@pytest.fixture
def stage(tmp_path):
    with running(tmp_path, robot=ROBOT) as stage:
        stage.wait_for("idle")
        set_off(stage, 0.4, SPEED_RAD_S)
        yield stage


def test_pulses_go_on_after_a_kill_until_stop_all_ends_them(stage, tmp_path):
    stage.end(signal.SIGKILL)
    killed_s = stage.sim.truth().time_s
    wait_until(lambda: stage.sim.truth().time_s > killed_s + 1.0, "a second goes by")
    truth = stage.sim.truth()
    assert all(joint.velocity_rad_s > SPEED_RAD_S / 2 for joint in truth.joints.values())
    assert all(joint.enabled for joint in truth.joints.values())
    settings = [f"line.pins.pwm_chip={json.dumps(str(tmp_path / 'pins'))}"]
    settings += [
        f'joint.{name}.pins={{ rpwm = "pwm{first}", lpwm = "pwm{first + 1}" }}'
        for name, first in (("left", 0), ("right", 2))
    ]
    options = [part for setting in settings for part in ("--set", setting)]
    done = subprocess.run(
        [sys.executable, "-m", "motord", "stop-all", str(ROBOT), "--json", *options],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)["lines"][0]["problems"] == []
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    assert not any(joint.enabled for joint in stage.sim.truth().joints.values())


def test_a_daemon_that_is_ended_leaves_no_pulses(stage):
    assert stage.end() == 0
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
