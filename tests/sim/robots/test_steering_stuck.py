# SPDX-License-Identifier: Apache-2.0
"""A simulated steered base with one blocked steering servo."""

import contextlib

from tests.sim.daemon_stage import ROOT, running, wait_until

from motord.client import Refused

ROBOT = ROOT / "config/robots/swerve4-servos.toml"
STEERING_UNIT = 2
RETRIED = tuple(
    f"joint.{place}{part}.{setting}"
    for place in ("front_left", "front_right", "rear_left", "rear_right")
    for part in ("", "_steering")
    for setting in ("tries=10", "reply_timeout_s=0.2")
)


def test_a_blocked_steering_servo_is_a_following_error_that_names_it_and_takes_the_power(tmp_path):
    with running(tmp_path, *RETRIED, robot=ROBOT) as stage:
        stage.sim.inject(f"blocked:unit={STEERING_UNIT}")

        def attempt():
            with contextlib.suppress(Refused):
                status = stage.robot.status()
                if "following_error" in status["faults"]:
                    return True
                if status["state"] == "fault":
                    stage.robot.reset()  # a fault of a busy machine
                if not status["armed"]:
                    stage.robot.arm()
                stage.robot.drive(0.0, 0.6)
            return False

        wait_until(attempt, stage.logged())
        why = " ".join(stage.robot.status()["why"])
        assert "following_error: front_left_steering has been far from its set-point" in why
        wait_until(
            lambda: not any(joint.enabled for joint in stage.sim.truth().joints.values()),
            "the drives have no power",
        )
