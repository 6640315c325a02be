# SPDX-License-Identifier: Apache-2.0
"""`motord calibrate` at a real terminal: the simulated robot differs from its file, and a person
measures its true pose to the millimetre and to half a degree."""

import math
import re

import pytest
from tests.sim.daemon_stage import HELD_TORQUE, ROOT, patient_on_can, wait_until
from tests.sim.person_stage import at_terminal, calibrated, copied, robot_of

from motord.config import load_robot

FORWARD_ONLY = ROOT / "config/robots/forward-only.toml"
RADIUS_M, TRACK_M = 0.0825, 0.45
TRUE_LEFT_M, TRUE_RIGHT_M, TRUE_TRACK_M = 1.03 * RADIUS_M, 1.02 * RADIUS_M, 0.96 * TRACK_M
TRUTH = (
    f"joint.left.wheel_radius_m={TRUE_LEFT_M}",
    f"joint.right.wheel_radius_m={TRUE_RIGHT_M}",
    f"base.track_m={TRUE_TRACK_M}",
)
SMALL = (
    "--distance-m", "1.5", "--turns", "1", "--side-m", "1", "--speed-m-s", "0.8",
    "--speed-rad-s", "2.0",
)  # fmt: skip


@pytest.mark.long
def test_radii_and_track_are_recovered_and_written(tmp_path):
    file = copied(tmp_path)
    with robot_of(tmp_path, file, truth=TRUTH) as stage:
        status, text = calibrated(stage, "all", *SMALL)
        assert status == 0, text
        wait_until(lambda: stage.state() == "idle", "disarmed")
    robot = load_robot(file)
    assert robot.wheel_radius_m("left") == pytest.approx(TRUE_LEFT_M, rel=0.003)
    assert robot.wheel_radius_m("right") == pytest.approx(TRUE_RIGHT_M, rel=0.003)
    assert robot.base.track_m == pytest.approx(TRUE_TRACK_M, rel=0.003)
    assert "square to the right: off by" in text
    assert len(list(tmp_path.glob("*.bak"))) == 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "rolling", "settings"),
    [("ackermann-servo", ["drive"], ("joint.drive.drive_watchdog_s=2.0",)),
     ("mecanum4", ["front_left", "front_right", "rear_left", "rear_right"], ())],
)  # fmt: skip
def test_the_wheel_radius_of_a_car_and_a_mecanum_base_is_found(tmp_path, name, rolling, settings):
    file = copied(tmp_path, ROOT / f"config/robots/{name}.toml")
    true_m = 1.03 * load_robot(file).base.wheel_radius_m
    truth = [f"joint.{joint}.wheel_radius_m={true_m}" for joint in rolling]
    with robot_of(tmp_path, file, *settings, truth=truth) as stage:
        status, text = calibrated(stage, "straight", "--distance-m", "1.5")
        assert status == 0, text
    assert load_robot(file).base.wheel_radius_m == pytest.approx(true_m, rel=0.003)


@pytest.mark.long
def test_the_feed_forward_of_a_duty_is_found(tmp_path):
    """The simulated motor stalls at 8 N·m, has 0.07 kg·m² and a friction of 0.48 N·m: it begins to
    turn at a duty of 6 %."""
    file = copied(tmp_path, FORWARD_ONLY, [("duty_dead_band = 0.06", "duty_dead_band = 0.02")])
    wheels = ("left.coulomb_n_m=0.48", "right.coulomb_n_m=0.48")
    with robot_of(tmp_path, file, wheels=wheels) as stage:
        status, text = calibrated(stage, "feedforward", "--speed-m-s", "0.5")
        assert status == 0, text
    for joint in load_robot(file).joint.values():
        assert joint.duty_dead_band == pytest.approx(0.06, rel=0.05)
        # 8 N·m · (duty − 0.06) = (8 / 18 + 0.02) N·m·s/rad · speed
        assert joint.full_duty_rad_s == pytest.approx(8.0 * 0.94 / (8.0 / 18.0 + 0.02), rel=0.02)
        assert joint.speed_loop.acceleration_s2_per_rad == pytest.approx(0.07 / 8.0, rel=0.1)
    assert text.count("acceleration_s2_per_rad 0 → ") == 2
    assert "rad/s)" in text


@pytest.mark.long
def test_the_feed_forward_of_a_torque_is_found_under_its_speed_loop(tmp_path):
    file = patient_on_can(tmp_path, "cia402-torque", "cia402-torque")
    with robot_of(tmp_path, file, *HELD_TORQUE) as stage:
        status, text = calibrated(stage, "deadband", "--speed-m-s", "0.5")
        assert (status, "takes a torque and no duty" in text) == (1, True), text
        status, text = calibrated(stage, "feedforward", "--speed-m-s", "0.5")
        assert status == 0, text
    for joint in load_robot(file).joint.values():
        loop = joint.speed_loop
        assert loop.inertia_kg_m2 == pytest.approx(0.07, rel=0.1)
        assert loop.static_n_m == pytest.approx(0.3, rel=0.1)
        assert loop.viscous_n_m_s_per_rad == pytest.approx(0.02, abs=0.005)
        assert loop.gain_n_m_s_per_rad == 1.0


@pytest.mark.long
@pytest.mark.parametrize("scale", [1.0, 1.03])
def test_the_scale_and_the_offset_of_a_gyro_are_measured(tmp_path, scale):
    file = copied(tmp_path, ROOT / "config/robots/esp32-imu.toml")
    imu = ("imu.timeout_s=1.0",)
    options = ("--gyro-scale", str(scale), "--seed", "5")
    with robot_of(tmp_path, file, *imu, simulator=options) as stage:
        wait_until(lambda: (stage.robot.status()["imu"] or {}).get("state") == "used", "the zero")
        status, text = calibrated(stage, "gyro", "--turns", "2", "--speed-rad-s", "2.0")
        assert status == 0, text
        true_rad_s = stage.robot.status()["imu"]["bias_rad_s"]
    found = re.search(r"offset ([-+.\d]+) rad/s, scale ([.\d]+) ± ([.\d]+)", text)
    bias_rad_s, measured, difference = (float(number) for number in found.groups())
    # the protractor's error is half a degree in two turns
    assert measured == pytest.approx(1.0 / scale, abs=2 * 0.5 / 720 + 1e-3)
    assert bias_rad_s == pytest.approx(true_rad_s, abs=5e-3)
    assert difference < 4 * 0.5 / 720 + 1e-3
    variance = load_robot(file).imu.turn_variance_rad2_per_rad
    assert variance == pytest.approx((measured - 1.0) ** 2 * math.tau, rel=0.1, abs=2e-6)


@pytest.mark.long
def test_the_paths_before_and_after_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    file, picture = copied(tmp_path), tmp_path / "paths.png"
    words = ("rotate", "--turns", "1", "--speed-rad-s", "2.0", "--plot", picture, "--dry-run")
    before = file.read_bytes()
    with robot_of(tmp_path, file, truth=TRUTH) as stage:
        status, text = calibrated(stage, *words)
        assert status == 0, text
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "paths.png: written" in text
    assert file.read_bytes() == before


def test_a_key_ends_a_run_at_rest_and_a_velocity_drive_has_no_dead_band(tmp_path):
    file = copied(tmp_path)
    with robot_of(tmp_path, file) as stage:
        status, text = calibrated(stage, "deadband")
        assert status == 1
        assert "holds the wheel's speed by itself" in text
        before = file.read_bytes()
        with at_terminal(
            "calibrate", "straight", "--distance-m", "3", "--socket", stage.socket
        ) as screen:
            screen.answer("does it stand on its mark", "y")
            screen.until(lambda: stage.sim.truth().distance_m > 0.1, "it drives")
            screen.type("q")
            assert screen.end() == 1
        assert "aborted: the robot is at rest and disarmed" in screen.text
        assert stage.state() == "idle"
        assert stage.sim.truth().at_rest
        assert file.read_bytes() == before
