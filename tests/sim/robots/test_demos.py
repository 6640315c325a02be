# SPDX-License-Identifier: Apache-2.0
"""Every shipped robot drives the course of `motord demo` to its end."""

import json
import subprocess
import sys

import pytest
from tests.long_cases import long_but
from tests.sim.daemon_stage import ROOT

from motord.config import load_robot
from motord.tools.demo_words import Source

ROBOTS = sorted(path.stem for path in (ROOT / "config/robots").glob("*.toml"))
ESTIMATED = {
    "ackermann-servo-pwm": Source.SETPOINTS,
    "forward-only": Source.SPEEDS,
    "hoverboard-rover": Source.SPEEDS,
    "sabertooth": Source.SETPOINTS,
    "sabertooth4": Source.SETPOINTS,
    "two-scs-servos": Source.SETPOINTS,
    "two-single-drives": Source.SPEEDS,
    "waveshare-ugv": Source.SPEEDS,
}
"""Source of the odometry of robots without position counters; that of others is judged."""
JOINTS = {"pan-tilt": {"pan": "position", "tilt": "position"}}
"""Robots without a base, and the kind of set-point that each joint takes."""
SENTENCES = {
    Source.COUNTERS: "every wheel has a position counter",
    Source.SPEEDS: "an estimate, not judged by a limit: a wheel without a position counter",
    Source.SETPOINTS: "an estimate, not judged by a limit: a wheel without a counter",
}
DEADLINE_S = 200.0
SERIAL = (
    "modbus-rtu", "mcu", "ascii", "roboclaw", "feetech", "dynamixel", "hoverboard", "sabertooth"
)  # fmt: skip


def patient(name):
    """Yield settings of time-outs that exceed the delays of a busy machine. The checks of the
    feedback are not changed: a healthy robot passes them on any machine."""
    path = ROOT / f"config/robots/{name}.toml"
    robot = load_robot(path)
    yield "safety.feedback_timeout_s=3.0"
    yield "safety.heartbeat_timeout_s=5.0"
    yield "safety.timeout_travel_max_m=1000.0"
    if any(robot.profiles[joint.drive].watchdog for joint in robot.joint.values()):
        yield "safety.drive_watchdog_s=2.0"
    if robot.imu is not None:
        yield "imu.timeout_s=1.0"
    for joint_name, joint in robot.joint.items():
        if robot.line[joint.line].kind in SERIAL:
            yield f"joint.{joint_name}.tries=10"
            yield f"joint.{joint_name}.reply_timeout_s=0.2"


def demo(name, *options):
    settings = [f"--set={setting}" for setting in patient(name)]
    # a swerve base stands until its wheels have turned to their directions
    seconds = "10" if name.startswith("swerve") else "5"
    return subprocess.run(
        [sys.executable, "-m", "motord", "demo", "--robot", name, "--seconds", seconds,
         *settings, *options],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        cwd=ROOT,
    )  # fmt: skip


@pytest.mark.parametrize("name", long_but(("demo", "asyncio-rs485"), ROBOTS))
def test_a_shipped_robot_drives_the_course_and_reports_its_odometry_error(name):
    run = demo(name, "--json")
    assert run.returncode == 0, run.stdout + run.stderr
    result = json.loads(run.stdout)
    assert result["ok"] is True
    assert result["safety"]["faults"] == []
    if name in JOINTS:
        assert {joint: one["takes"] for joint, one in result["joints"].items()} == JOINTS[name]
        assert all(one["travel_rad"] > 0.5 for one in result["joints"].values())
        return
    assert result["odometry"]["distance_m"] > 0.5
    if name.startswith("asyncio-"):
        assert set(result["engine"].values()) == {"asyncio"}
    source = ESTIMATED.get(name, Source.COUNTERS)
    assert result["odometry"]["source"] == source
    assert result["odometry"]["judged"] == (source is Source.COUNTERS)
    found = result["odometry"]
    assert result["worth"].startswith(SENTENCES[source])
    if source is not Source.COUNTERS:
        off_mm = f"{1000 * found['position_error_m']:.0f} mm"
        assert f"in this run it was {off_mm}" in result["worth"]
