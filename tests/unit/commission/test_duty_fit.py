# SPDX-License-Identifier: Apache-2.0
"""Fit of the dead band and of the speed at full duty to steady speeds."""

import random
from pathlib import Path

import pytest
from tests.unit.messages.bus_views import joint, view

from motord.commission.calibrate.duty import Point, duty_changes, duty_joints, fit_duty, steady
from motord.commission.person import Failed
from motord.config import load_robot

ROBOTS = Path(__file__).resolve().parents[3] / "config/robots"
DUTIES = (0.05, 0.15, 0.25, 0.4, 0.55, 0.7)


def points(dead_band=0.06, full_duty_rad_s=14.0, noise_rad_s=0.0, seed=0):
    noise = random.Random(seed)
    found = []
    for sign in (1.0, -1.0):
        for duty in DUTIES:
            speed = max(duty - dead_band, 0.0) / (1.0 - dead_band) * full_duty_rad_s
            speed += noise.gauss(0.0, noise_rad_s) if speed else 0.0
            found.append(Point(sign * duty, sign * speed))
    return found


def test_feedback_that_a_busy_machine_delays_does_not_distort_a_speed():
    """The position belongs to the time of the feedback, not to that of the state."""
    late_ms = {100: 90, 2000: 95}
    snapshots = []
    for at_ms in range(100, 2001, 20):
        age_s = late_ms.get(at_ms, 5) / 1000.0
        turned = joint(
            duty=0.3,
            setpoint_rad_s=4.0,
            position_rad=4.0 * (at_ms / 1000.0 - age_s),
            feedback_age_s=age_s,
        )
        snapshots.append(view(at_ms, joints=(turned,)).snapshot)
    found = steady(snapshots, 0)
    assert (found.duty, found.velocity_rad_s) == (pytest.approx(0.3), pytest.approx(4.0))


def test_a_reply_that_a_busy_machine_delays_does_not_distort_a_speed():
    """The last position is 25 ms older than its stamp, which is 3 % of 0.8 s."""
    snapshots = []
    for at_ms in range(100, 2001, 20):
        late_s = 0.025 if at_ms == 2000 else 0.0
        turned = joint(duty=0.3, setpoint_rad_s=4.0, position_rad=4.0 * (at_ms / 1000.0 - late_s),
                       feedback_age_s=0.005)  # fmt: skip
        snapshots.append(view(at_ms, joints=(turned,)).snapshot)
    assert steady(snapshots, 0).velocity_rad_s == pytest.approx(4.0, rel=0.002)


def test_a_duty_that_a_speed_loop_changes_is_averaged_while_the_set_point_is_held():
    snapshots = []
    for n, at_ms in enumerate(range(100, 2001, 20)):
        turned = joint(duty=0.3 + 0.02 * (-1) ** n, setpoint_rad_s=4.0,
                       position_rad=4.0 * at_ms / 1000.0, feedback_age_s=0.005)  # fmt: skip
        snapshots.append(view(at_ms, joints=(turned,)).snapshot)
    found = steady(snapshots, 0)
    assert found.duty == pytest.approx(0.3, abs=1e-3)
    assert found.velocity_rad_s == pytest.approx(4.0)


def test_exact_speeds_give_the_exact_dead_band():
    found = fit_duty("left", points())
    assert found.dead_band == pytest.approx(0.06)
    assert found.full_duty_rad_s == pytest.approx(14.0)


@pytest.mark.parametrize("seed", range(5))
def test_noisy_speeds_give_the_dead_band_within_its_deviations(seed):
    found = fit_duty("left", points(noise_rad_s=0.05, seed=seed))
    assert abs(found.dead_band - 0.06) < 4.0 * found.dead_band_deviation
    assert 0.0 < found.dead_band_deviation < 0.01


def test_a_wheel_that_hardly_moves_is_refused():
    with pytest.raises(Failed, match="turned at 2 of 12 levels"):
        fit_duty("left", points(dead_band=0.6))


def test_a_wheel_that_turns_against_its_duty_is_refused():
    with pytest.raises(Failed, match="turned against its duty"):
        fit_duty("left", [Point(-one.duty, one.velocity_rad_s) for one in points()])


def test_speeds_that_do_not_fit_a_line_are_refused():
    bent = [Point(one.duty, one.velocity_rad_s**3) for one in points()]
    with pytest.raises(Failed, match="does not rise evenly"):
        fit_duty("left", bent)


def test_a_drive_that_holds_its_speed_has_nothing_to_calibrate():
    with pytest.raises(Failed, match="zlac8015d: holds the wheel's speed by itself"):
        duty_joints(load_robot(ROBOTS / "demo.toml"))


def test_the_dead_band_alone_leaves_the_speed_at_full_duty():
    robot = load_robot(ROBOTS / "pi4-encoders.toml")
    fits = {"left": fit_duty("left", points())}
    assert set(duty_changes(robot, fits, feed_forward=False)) == {
        ("joint", "left", "duty_dead_band")
    }
    both = duty_changes(robot, fits, feed_forward=True)
    assert both["joint", "left", "full_duty_rad_s"] == 14.0
