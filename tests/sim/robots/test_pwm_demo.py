# SPDX-License-Identifier: Apache-2.0
"""A robot on two bridges at a computer's pins drives the course, as `motord demo --robot
pi5-bts7960` does. Also: the motion of its wheels when the daemon is killed."""

import json
import re
import signal
import subprocess
import sys

import pytest
from tests.long_cases import long_but
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, set_off, wait_until

ROBOT = ROOT / "config/robots/pi5-bts7960.toml"
PATIENT = "\n[safety]\nfeedback_timeout_s = 2.0\nheartbeat_timeout_s = 2.0\n"
"""Section with which a delay by a busy machine is no fault."""
SPEED_RAD_S = 5.0


def test_a_robot_on_pins_drives_the_course_with_accurate_odometry(tmp_path):
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


BY_GPIO = {
    "l298n": ('ena = "pwm{0}", in1 = "GPIO{1}", in2 = "GPIO{2}"', "0.1"),
    "tb6612fng": ('pwm = "pwm{0}", in1 = "GPIO{1}", in2 = "GPIO{2}", stby = "GPIO{3}"', "0.05"),
    "cytron-mdd": ('pwm = "pwm{0}", dir = "GPIO{1}"', "0.03"),
}
"""Pins and dead band of each bridge whose direction GPIO lines select."""


def blind_robot(drive):
    """Return the file of pi4-encoders with another bridge, without encoders and gyro."""
    text = (ROOT / "config/robots/pi4-encoders.toml").read_text(encoding="utf-8")
    pins, dead_band = BY_GPIO[drive]
    text = re.sub(r"\[(imu|joint\.\w+\.encoder)\]\n([^\[\n].*\n|\n)*", "", text)
    left, right = (pins.format(*numbers) for numbers in ((0, 5, 6, 7), (1, 16, 26, 25)))
    placed = iter((left, right))
    text = re.sub(r"pins = \{.*\}", lambda _: f"pins = {{ {next(placed)} }}", text)
    text = re.sub(r"duty_dead_band = .*", f"duty_dead_band = {dead_band}", text)
    return text.replace('"tb6612fng"', f'"{drive}"') + PATIENT


@pytest.mark.parametrize("drive", long_but((), BY_GPIO))
def test_a_bridge_with_its_direction_on_gpio_lines_drives_and_its_odometry_is_an_estimate(
    tmp_path, drive
):
    path = tmp_path / "blind.toml"
    path.write_text(blind_robot(drive), encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "motord", "demo", "--json", "--seconds", "5", "--robot", path],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        cwd=ROOT,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    result = json.loads(run.stdout)
    assert result["ok"] is True
    found = result["odometry"]
    assert found["source"] == "set-points"
    assert found["judged"] is False
    assert found["distance_m"] > 0.5
    off_mm = f"{1000 * found['position_error_m']:.0f} mm"
    assert result["worth"].startswith("an estimate")
    assert f"in this run it was {off_mm}" in result["worth"]


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


def test_a_daemon_that_ends_leaves_no_pulses(stage):
    assert stage.end() == 0
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    assert not any(joint.enabled for joint in stage.sim.truth().joints.values())
