# SPDX-License-Identifier: Apache-2.0
"""A daemon on drives whose feedback fails or that ignore their set-points, on both engines."""

import contextlib
import math
import time

import pytest
from tests.long_cases import long_but
from tests.sim.daemon_stage import DEADLINE_S, running, set_off, wait_until

from motord.client import Refused

SPEED_M_S = 0.4125  # a set-point of 5 rad/s
BUSY = {"external", "heartbeat_lost", "feedback_stale", "drive_disabled"}
DEFECTS = {
    "frozen-counter:unit=1,for_s=2": "implausible_feedback",
    "false-velocity:unit=1,rad_s=343": "implausible_feedback",
    "turned-encoder:unit=1": "direction",
    "blocked:unit=1": "stall",
    "runaway:unit=1,rad_s=15": "runaway",
}


@pytest.mark.parametrize("defect", DEFECTS)
@pytest.mark.parametrize("engine", long_but(["rt"], ["rt", "asyncio"]))
def test_feedback_that_breaks_at_speed_is_a_fault_that_names_the_wheel_and_stops_the_drives(
    tmp_path, engine, defect
):
    with running(tmp_path, f'line.rs485.engine="{engine}"') as stage:
        status = hurt(stage, defect)
        assert status["faults"][0] == DEFECTS[defect]
        assert status["why"][0].startswith(f"{DEFECTS[defect]}: left ")
        assert " at a set-point of 5.00 rad/s, for " in status["why"][0]
        assert "check " in status["why"][0]
        wait_until(lambda: not powered(stage), "the drives have no power")
        wait_until(lambda: stage.sim.truth().at_rest, "the wheels are at rest")


def powered(stage):
    return any(joint.enabled for joint in stage.sim.truth().joints.values())


def hurt(stage, defect):
    """Drive with the defect until a fault is latched; reset a fault that a busy machine causes."""
    end_s = time.monotonic() + 4 * DEADLINE_S
    while time.monotonic() < end_s:
        stage.sim.clear_faults_script()
        set_off(stage, SPEED_M_S, 4.5)
        stage.sim.inject(defect)
        drive_until(stage, lambda: stage.state() == "fault")
        status = stage.robot.status()
        if not BUSY.issuperset(status["faults"]):
            return status
    raise AssertionError(stage.logged())


def drive_until(stage, condition):
    """Send commands until the condition holds."""

    def attempt():
        with contextlib.suppress(Refused):
            stage.robot.drive(SPEED_M_S, 0.0)
        return condition()

    wait_until(attempt, stage.logged())


def test_after_a_repair_and_a_reset_the_robot_drives_again(tmp_path):
    with running(tmp_path) as stage:
        hurt(stage, "blocked:unit=1")
        stage.sim.clear_faults_script()
        wait_until(lambda: not powered(stage), "the drives have no power")
        stage.robot.reset()
        assert stage.robot.status()["faults"] == []
        set_off(stage, SPEED_M_S, 4.5)
        assert not math.isnan(stage.robot.status()["joints"]["left"]["velocity_rad_s"])
