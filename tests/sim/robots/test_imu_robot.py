# SPDX-License-Identifier: Apache-2.0
"""A daemon on a simulated board with a gyro: one side slips, and the heading stays right."""

import contextlib
import json
import math
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import ROOT, running, wait_until

from motord.client import Refused

ROBOT = ROOT / "config/robots/esp32-imu.toml"
PLAIN = ROOT / "config/robots/esp32.toml"
TRIES = ("joint.left.tries=10", "joint.right.tries=10")
PATIENT = ("imu.timeout_s=1.0", *TRIES)


def gyro(stage):
    return (stage.robot.status()["imu"] or {}).get("state")


def turned_and_slipped(stage):
    """Turn half a turn left while the left wheels slip; return the error of the heading."""
    stage.wait_for("idle")
    stage.sim.inject("slip:side=0,part=0.8")

    def far_enough():
        with contextlib.suppress(Refused):
            status = stage.robot.status()
            if status["state"] == "fault":  # a fault of a busy machine
                stage.robot.reset()
            if not status["armed"]:
                stage.robot.arm()
            stage.robot.drive(0.15, 0.8)
        return stage.sim.truth().turned_rad > math.pi

    wait_until(far_enough, "half a turn")
    wait_until(lambda: stage.robot.status()["at_rest"] and stage.sim.truth().at_rest, "rest")
    wait_until(lambda: stage.robot.status()["odometry"]["age_s"] < 0.1, "feedback at rest")
    heading_rad = stage.robot.status()["odometry"]["heading_rad"]
    return abs(math.remainder(heading_rad - stage.sim.truth().heading_rad, math.tau))


def test_the_heading_stays_right_when_one_side_slips(tmp_path):
    with running(tmp_path, *PATIENT, robot=ROBOT) as stage:
        wait_until(lambda: gyro(stage) == "used", "the gyro's zero")
        zero_rad_s = stage.robot.status()["imu"]["bias_rad_s"]
        assert 0.0 < abs(zero_rad_s) < 0.036
        asked = [sys.executable, "-m", "motord", "status", "--socket", str(stage.socket)]
        shown = subprocess.run(asked, capture_output=True, text=True, timeout=60, check=True)
        (row,) = [row for row in shown.stdout.splitlines() if row.startswith("imu ")]
        assert "zero at " in row
        assert row.split()[1] == "used,"
        error_rad = turned_and_slipped(stage)
        imu = stage.robot.status()["imu"]
        assert imu["refused"] == 0
        assert imu["acceleration_m_s2"][2] == pytest.approx(9.8, abs=0.2)
    assert error_rad < 0.1


def test_without_a_gyro_the_same_slip_turns_the_heading_away(tmp_path):
    with running(tmp_path, *TRIES, robot=PLAIN) as stage:
        assert stage.robot.status()["imu"] is None
        assert turned_and_slipped(stage) > 0.5


def test_published_samples_are_in_the_bases_axes(tmp_path):
    over = (
        "imu.up=-y",
        "imu.forward=z",
        *PATIENT,
        "publish.console.kind=stdout",
        "publish.console.rate_hz=20",
    )
    with (
        running(tmp_path, *over, robot=ROBOT, stdout=subprocess.PIPE) as stage,
        stage.daemon.stdout,
    ):
        # the simulator keeps the file's mounting, z up; here z is configured as forward
        wait_until(lambda: gyro(stage), "the gyro")
        felt = wait_until(lambda: stage.robot.status()["imu"]["acceleration_m_s2"], "a measure")
        assert felt[0] == pytest.approx(9.8, abs=0.2)

        def published():
            return json.loads(stage.daemon.stdout.readline())["imu"]

        assert wait_until(published, "a snapshot with the imu")["state"] in ("unbiased", "used")


def test_a_missing_chip_is_reported_once_and_the_wheels_give_the_heading(tmp_path):
    text = PLAIN.read_text(encoding="utf-8")
    robot = tmp_path / "robot.toml"
    robot.write_text(text + '[imu]\nsource = "mpu6050"\nbus = "/nowhere/i2c-1"\n', encoding="utf-8")
    with running(tmp_path, robot=robot) as stage:
        wait_until(lambda: "there is no such I2C bus" in stage.logged(), "the log line")
        stage.wait_for("idle")
        stage.robot.arm()
        wait_until(lambda: "the imu sends nothing" in stage.logged(), "the log line")
        assert stage.logged().count("there is no such I2C bus") == 1
        assert stage.robot.status()["imu"] is None


def test_a_drive_by_gyro_is_replayed_bit_for_bit(tmp_path):
    tape = (
        "publish.tape.kind=mcap",
        f"publish.tape.folder={json.dumps(str(tmp_path / 'files'))}",
        "publish.tape.journal=true",
        "publish.tape.free_min_mb=0",
    )
    with running(tmp_path, *PATIENT, *tape, robot=ROBOT) as stage:
        wait_until(lambda: gyro(stage) == "used", "the gyro's zero")
        wait_until(lambda: list((tmp_path / "files").glob("*.mcap")), "a recording")
        turned_and_slipped(stage)
        assert stage.robot.status()["imu"]["heading_by_gyro"]
        assert stage.end() == 0
    (path,) = (tmp_path / "files").glob("*.mcap")
    done = subprocess.run(
        [sys.executable, "-m", "motord", "replay", "--json", str(path)],
        capture_output=True, text=True, timeout=120, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
