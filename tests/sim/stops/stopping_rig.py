# SPDX-License-Identifier: Apache-2.0
"""A robot that moves, and the time that it takes to come to rest."""

import contextlib
import subprocess
import sys

from tests.sim.daemon_stage import ROOT, wait_until

from motord.client import Refused

HOGGED = ("-m", "tests.sim.hogged_daemon")

BUSY_S = 1.0

SPEED_M_S = 0.5


@contextlib.contextmanager
def moving(stage, robot, speed_m_s=SPEED_M_S):
    """Start a source in its own process that drives straight on, wait until the simulated wheels
    turn, and yield it. If a busy machine latches a fault before, reset it and start another one."""
    stage.wait_for("idle")
    fast_rad_s = 0.9 * speed_m_s / robot.base.wheel_radius_m
    with contextlib.ExitStack() as sources:

        def turning():
            state = stage.state()
            if state in ("armed", "moving"):
                if not started or started[-1].poll() is not None:
                    started.append(sources.enter_context(source(stage, speed_m_s)))
                return slowest_wheel_rad_s(stage) > fast_rad_s
            for process in started:
                process.kill()
            with contextlib.suppress(Refused):
                if state == "idle":
                    stage.robot.arm()
                elif state == "fault":
                    stage.robot.reset()
            return False

        started = []
        wait_until(turning, "the wheels turn")
        yield started[-1]


@contextlib.contextmanager
def source(stage, speed_m_s):
    command = [sys.executable, "-m", "tests.sim.straight_on", str(stage.socket), str(speed_m_s)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=ROOT)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def slowest_wheel_rad_s(stage):
    return min(abs(joint.velocity_rad_s) for joint in stage.sim.truth().joints.values())


def powered(stage):
    return any(joint.enabled for joint in stage.sim.truth().joints.values())


def seconds_to_rest(stage, hurt):
    """Call `hurt`; return the seconds from just before it until the last wheel stood."""
    before_s = stage.sim.truth().time_s
    hurt()
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")
    truth = stage.sim.truth()
    return truth.time_s - truth.rest_since_s - before_s
