# SPDX-License-Identifier: Apache-2.0
"""Messages hold the snapshot's values: units, frames, stamps, and only what was measured."""

import dataclasses
import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.unit.messages.bus_views import message as message_of

from motord.api.snapshot import STATES, ImuSnapshot, JointSnapshot, Snapshot
from motord.bus.messages.sources import UNMEASURED, Body, Level, state_name
from motord.bus.messages.topics import View
from motord.control.machine import State

BODY = Body(robot="r2", joints=("left", "right"))
OFFSET_NS = 1_700_000_000_000_000_000
TICK_NS = 90_000_000_000


def message(name, now, status=None):
    return message_of(name, View(snapshot=now, status=status), BODY, OFFSET_NS)


def stamp(sec, nanosec):
    return SimpleNamespace(sec=sec, nanosec=nanosec)


def joint(**changes):
    plain = {field.name: 0.0 for field in dataclasses.fields(JointSnapshot)}
    words = {"enabled": True, "drive_faults": 0, "jumps": 0, "stale": False, "voltage_v": math.nan}
    return JointSnapshot(**plain | words | changes)


def snapshot(**changes):
    plain = {field.name: 0.0 for field in dataclasses.fields(Snapshot)} | {"imu": None}
    flags = dict.fromkeys(("armed", "enabled", "at_rest", "odometry_degraded"), False)
    rest = {
        "stamp_ns": TICK_NS, "odometry_stamp_ns": TICK_NS - 7_000_000, "tick": 9,
        "reasons": (), "faults": (), "joints": (joint(), joint()), "version": 1, "owner": 0,
        "odometry_epoch": 0, "machine_state": 4, "pose_covariance": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        "twist_covariance": (7.0, 8.0, 9.0), "lateral_covariance": (0.0,) * 3,
        "rest": "turning", "rest_unknown_since_ns": (0,) * 8, "rest_unmeasured": 0,
        "counter_coarse": 0, "counter_distrusted": 0,
    }  # fmt: skip
    return Snapshot(**plain | flags | rest | changes)


def test_odometry_is_the_pose_in_the_odometry_frame_and_the_twist_in_the_base_frame():
    now = snapshot(x_m=1.0, y_m=-2.0, heading_rad=math.pi / 2, linear_m_s=0.3, angular_rad_s=-1)
    found = message("odom", now)
    assert (found.header.frame_id, found.child_frame_id) == ("odom", "base_link")
    place, turn = found.pose.pose.position, found.pose.pose.orientation
    assert (place.x, place.y, place.z) == (1.0, -2.0, 0.0)
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert (turn.z, turn.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert (found.twist.twist.linear.x, found.twist.twist.angular.z) == (0.3, -1)


def test_the_stamp_of_odometry_is_that_of_the_feedback_not_of_the_tick_nor_of_the_sending():
    found = message("odom", snapshot())
    assert found.header.stamp == stamp(1_700_000_089, 993_000_000)
    status = message("motor_status", snapshot())
    assert status.header.stamp == stamp(1_700_000_090, 0)


def test_covariance_has_its_six_planar_numbers_in_their_places_and_is_symmetric():
    found = message("odom", snapshot())
    pose, twist = found.pose.covariance, found.twist.covariance
    assert [pose[at] for at in (0, 1, 5, 7, 11, 35)] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert [twist[at] for at in (0, 5, 35)] == [7.0, 8.0, 9.0]
    for matrix in (pose, twist):
        assert all(matrix[6 * r + c] == matrix[6 * c + r] for r in range(6) for c in range(6))
        assert [matrix[at] for at in (14, 21, 28)] == [UNMEASURED] * 3


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["x_m", "y_m", "heading_rad"])
def test_a_pose_that_is_not_finite_is_no_odometry_and_no_transform(field, bad):
    now = snapshot(**{field: bad})
    assert message("odom", now) is None
    assert message("tf", now) is None


def test_before_the_first_feedback_there_is_no_odometry():
    assert message("odom", snapshot(odometry_stamp_ns=0)) is None
    assert message("tf", snapshot(odometry_stamp_ns=0)) is None


def test_a_twist_that_is_not_finite_is_no_odometry_but_a_transform():
    now = snapshot(linear_m_s=math.nan)
    assert message("odom", now) is None
    assert message("tf", now) is not None


@given(heading_rad=st.floats(-math.pi, math.pi))
def test_the_transform_is_the_odometry_and_its_quaternion_has_length_one(heading_rad):
    now = snapshot(heading_rad=heading_rad, x_m=3.0)
    (transform,) = message("tf", now).transforms
    pose = message("odom", now).pose.pose
    turn = transform.transform.rotation
    assert (transform.transform.translation, turn) == (pose.position, pose.orientation)
    assert math.hypot(turn.x, turn.y, turn.z, turn.w) == pytest.approx(1.0)
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(heading_rad)


@pytest.mark.parametrize(
    "silent",
    [joint(feedback_age_s=math.inf), joint(position_rad=7.0, feedback_age_s=8.9, stale=True)],
    ids=["never", "no more"],
)
def test_joints_without_fresh_feedback_are_left_out(silent):
    now = snapshot(joints=(silent, joint(position_rad=5.0, feedback_age_s=0.25)))
    found = message("joint_states", now)
    assert (found.name, found.position) == (("right",), [5.0])
    assert found.header.stamp == stamp(1_700_000_089, 750_000_000)


def test_the_stamp_of_joint_states_is_that_of_the_newest_feedback():
    ages_s = ((0.25, 0.1), (0.1, 0.25))
    for pair_s in ages_s:
        now = snapshot(joints=tuple(joint(feedback_age_s=age_s) for age_s in pair_s))
        assert message("joint_states", now).header.stamp == stamp(1_700_000_089, 900_000_000)


def test_the_battery_has_the_stamp_of_its_measurement():
    now = snapshot(joints=(joint(voltage_v=24.5, feedback_age_s=0.5), joint(feedback_age_s=0.0)))
    assert message("battery_state", now).header.stamp == stamp(1_700_000_089, 500_000_000)


def test_a_joint_state_keeps_a_velocity_that_is_not_measured_as_nan_in_its_place():
    now = snapshot(joints=(joint(velocity_rad_s=math.nan), joint(velocity_rad_s=2.0)))
    found = message("joint_states", now)
    assert math.isnan(found.velocity[0])
    assert found.velocity[1] == 2.0
    assert found.effort == ()


def test_without_a_joint_that_has_a_position_there_is_no_joint_state():
    lost = joint(position_rad=math.nan)
    assert message("joint_states", snapshot(joints=(lost, lost))) is None


def test_the_battery_is_the_lowest_voltage_of_a_fresh_drive_and_the_rest_unknown():
    now = snapshot(joints=(joint(voltage_v=24.5), joint(voltage_v=24.1)))
    found = message("battery_state", now)
    assert found.voltage == 24.1
    assert found.present
    assert all(map(math.isnan, (found.current, found.percentage, found.temperature)))


def test_a_stale_drive_reports_nothing_of_the_battery():
    assert message("battery_state", snapshot()) is None
    old = snapshot(joints=(joint(voltage_v=9.0, stale=True), joint()))
    assert message("battery_state", old) is None


def test_diagnostics_show_the_base_and_each_joint_by_severity():
    now = snapshot(
        machine_state=6,
        faults=("drive",),
        joints=(joint(drive_faults=0x20), joint(stale=True, feedback_age_s=math.inf)),
    )
    base, left, right = message("diagnostics", now).status
    assert [status.level for status in (base, left, right)] == [
        Level.ERROR, Level.ERROR, Level.STALE,
    ]  # fmt: skip
    assert base.message == "fault: drive"
    assert "0x20" in left.message
    assert {pair.key: pair.value for pair in right.values}["feedback_age_s"] == "inf"


def test_degraded_odometry_is_a_warning():
    base, *_ = message("diagnostics", snapshot(odometry_degraded=True)).status
    assert base.level is Level.WARN


def test_motor_status_reports_the_commander_and_one_value_a_joint():
    boss = {
        "number": 3, "owner": "autopilot", "priority": 50, "why": "in command: the only one"
    }  # fmt: skip
    found = message("motor_status", snapshot(owner=3), {"leases": [boss]})
    assert (found.commander, found.commander_priority) == ("autopilot", 50)
    assert found.commander_why == "in command: the only one"
    free = message("motor_status", snapshot())
    assert (free.commander, free.commander_priority, free.state) == ("", 0, "moving")
    assert len(found.name) == len(found.duty) == len(found.stale) == 2


def test_states_have_the_names_and_numbers_of_the_state_machine():
    assert tuple(state.value for state in State) == STATES
    assert state_name(snapshot(machine_state=99)) == "state 99"


def test_a_snapshot_of_another_number_of_joints_is_refused():
    with pytest.raises(ValueError, match="1 joints, and the robot file has 2"):
        message("joint_states", snapshot(joints=(joint(),)))


def inertial(**changes):
    values = {
        "stamp_ns": TICK_NS - 3_000_000, "angular_rad_s": (0.1, 0.2, 0.3),
        "acceleration_m_s2": (0.0, -0.5, 9.8), "bias_rad_s": 0.02, "bias_variance_rad2_s2": 1e-8,
        "rate_variance_rad2_s2": 1e-6, "state": "used", "heading_by_gyro": True, "still": False,
        "refused": 0,
    }  # fmt: skip
    return snapshot(imu=ImuSnapshot(**values | changes))


def test_an_imu_has_its_own_stamp_no_orientation_and_the_variance_that_was_measured():
    found = message("imu", inertial())
    assert found.header.stamp == stamp(1_700_000_089, 997_000_000)
    assert found.header.frame_id == "base_link"
    assert found.orientation_covariance == (-1.0, *[0.0] * 8)
    rate = found.angular_velocity
    assert (rate.x, rate.y, rate.z) == (0.1, 0.2, 0.3)
    diagonal = [found.angular_velocity_covariance[4 * axis] for axis in range(3)]
    assert diagonal[2] == pytest.approx(1.01e-6)
    within_sigma = [0.35**2 <= variance < 0.2 for variance in diagonal[:2]]
    assert all(within_sigma), "about x and y their zero is in the rate: it was not taken away"
    assert found.linear_acceleration.z == 9.8
    assert found.linear_acceleration_covariance == (0.0,) * 9


def test_what_an_imu_does_not_measure_is_marked_as_unmeasured():
    bare = inertial(angular_rad_s=(math.nan, math.nan, 0.3), acceleration_m_s2=(math.nan,) * 3)
    found = message("imu", bare)
    assert found.linear_acceleration_covariance[0] == -1.0
    rate, covariance = found.angular_velocity, found.angular_velocity_covariance
    assert (rate.x, rate.y, rate.z) == (0.0, 0.0, 0.3)
    assert (covariance[0], covariance[4]) == (UNMEASURED, UNMEASURED)
    assert covariance[8] == pytest.approx(1.01e-6)


def test_before_the_gyro_has_a_zero_its_error_is_unknown():
    unknown = {"bias_variance_rad2_s2": math.nan, "rate_variance_rad2_s2": math.nan}
    found = message("imu", inertial(state="unbiased", **unknown))
    assert tuple(found.angular_velocity_covariance) == (0.0,) * 9


@pytest.mark.parametrize(
    "changes", [{"state": "stale"}, {"state": "reversed"}, {"angular_rad_s": (0.0, 0.0, math.nan)}]
)
def test_an_old_or_invalid_imu_gives_no_message(changes):
    assert message("imu", inertial(**changes)) is None
    assert message("imu", snapshot()) is None


@pytest.mark.parametrize(
    ("state", "level"),
    [
        ("used", Level.OK),
        ("unbiased", Level.WARN),
        ("stale", Level.STALE),
        ("reversed", Level.ERROR),
    ],
)
def test_diagnostics_report_the_state_of_the_imu(state, level):
    found = message("diagnostics", inertial(state=state, refused=7)).status[-1]
    assert (found.name, found.level, found.message) == ("r2: imu", level, state)
    assert {pair.key: pair.value for pair in found.values}["refused"] == "7"
    names = [status.name for status in message("diagnostics", snapshot()).status]
    assert "r2: imu" not in names
