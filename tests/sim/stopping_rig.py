# SPDX-License-Identifier: Apache-2.0
"""A robot that moves, and the time that it takes to come to rest."""

import contextlib
import subprocess
import sys
from pathlib import Path

from daemon_stage import wait_until

HOGGED = (str(Path(__file__).with_name("hogged_daemon.py")),)

BUSY_S = 1.0

SPEED_M_S = 0.5

SOURCE = """
import sys, time
from motord.client import Client
with Client(sys.argv[1]) as robot:
    while True:
        robot.drive(float(sys.argv[2]), 0.0, owner="source")
        time.sleep(0.05)
"""


@contextlib.contextmanager
def moving(stage, robot, speed_m_s=SPEED_M_S):
    """A source in a process of its own drives straight on, and the true wheels turn."""
    stage.wait_for("idle")
    stage.robot.arm()
    source = subprocess.Popen(
        [sys.executable, "-c", SOURCE, str(stage.socket), str(speed_m_s)],
        stderr=subprocess.DEVNULL,
    )
    fast_rad_s = 0.9 * speed_m_s / robot.base.wheel_radius_m
    try:
        wait_until(lambda: slowest_wheel_rad_s(stage) > fast_rad_s, "the wheels turn")
        yield source
    finally:
        source.kill()
        source.wait()


def slowest_wheel_rad_s(stage):
    return min(abs(joint.velocity_rad_s) for joint in stage.sim.truth().joints.values())


def powered(stage):
    return any(joint.enabled for joint in stage.sim.truth().joints.values())


def seconds_to_rest(stage, hurt):
    """From just before `hurt()` until the last wheel stood."""
    before_s = stage.sim.truth().time_s
    hurt()
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    truth = stage.sim.truth()
    return truth.time_s - truth.rest_since_s - before_s
