# SPDX-License-Identifier: Apache-2.0
"""Any message, sent in error or on purpose, is a valid command or is refused."""

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.unit.bus.gate_rig import DEMO, gate

from motord.bus.commands.gate import FUTURE_S, OLD_S, NotTaken, short, tag
from motord.bus.commands.senders import Sender

NUMBERS = st.floats() | st.integers() | st.just(10**400) | st.just(-(10**400))
JSON = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["twist", "linear", "angular", "header", "stamp", "sec", "x", "z", "a"]
            ),
            inner,
            max_size=5,
        )
    ),
    max_leaves=12,
)


@pytest.fixture(scope="module")
def unstamped(tmp_path_factory):
    return gate(tmp_path_factory, stamped=False)


@given(message=JSON)
def test_anything_that_is_json_is_taken_or_refused(unstamped, message):
    with pytest.raises(NotTaken):  # a well-formed command is refused too: it has no lease
        unstamped.drive(message)


@given(message=JSON)
def test_anything_that_is_json_is_a_command_of_joints_or_refused(unstamped, message):
    with pytest.raises(NotTaken):
        unstamped.drive_joints(message)


@given(
    names=st.lists(st.sampled_from(["left", "right", "tail", ""]) | JSON, max_size=3) | JSON,
    speeds=st.lists(NUMBERS, max_size=3) | JSON,
)
def test_joints_have_a_velocity_each_or_are_refused(unstamped, names, speeds):
    try:
        velocity_rad_s, age_s = unstamped._wheels({"name": names, "velocity": speeds})
    except NotTaken:
        return
    assert age_s == 0.0
    asked = dict(zip(names, speeds, strict=True))
    assert set(asked) <= {"left", "right"}
    theirs = [float(asked.get(name, 0.0)) for name in ("left", "right")]
    assert [str(speed) for speed in velocity_rad_s] == [str(speed) for speed in theirs]


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ({"name": ["left", "tail"], "velocity": [1.0, 1.0]}, "left, right"),
        ({"name": ["left", "right"], "velocity": [1.0]}, "one velocity"),
        ({"name": ["left", "left"], "velocity": [1.0, 1.0]}, "one velocity"),
        ({"name": ["left"]}, "not a JointState"),
    ],
)
def test_joints_that_are_not_all_there_are_refused_with_the_reason(unstamped, message, why):
    with pytest.raises(NotTaken, match=why):
        unstamped.drive_joints(message)


def test_joints_without_a_stamp_are_refused_where_one_is_required(stamped):
    with pytest.raises(NotTaken, match="no stamp"):
        stamped.drive_joints({"name": ["left"], "velocity": [1.0]})


@pytest.fixture(scope="module")
def head(tmp_path_factory):
    return gate(tmp_path_factory, robot=DEMO.with_name("pan-tilt.toml"), stamped=False)


@given(message=JSON)
def test_anything_that_is_json_is_a_command_of_free_joints_or_refused(head, message):
    with pytest.raises(NotTaken):
        head.drive_joints(message)


def test_joints_without_a_base_have_a_position_each(head):
    message = {"name": ["tilt", "pan"], "position": [0.2, -0.4], "velocity": []}
    assert head._free_joints(message) == ({}, {1: 0.2, 0: -0.4}, 0.0)
    both = {"name": ["pan"], "position": [0.5], "velocity": [9.0]}
    assert head._free_joints(both) == ({}, {0: 0.5}, 0.0)


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ({"name": ["roll"], "position": [0.1]}, "not one of pan, tilt"),
        ({"name": ["pan", "pan"], "position": [0.1, 0.2]}, "named once"),
        ({"name": ["pan"], "velocity": [0.1]}, "joint pan takes a position"),
        ({"name": ["pan", "tilt"], "position": [0.1]}, "not one each"),
        ({"name": ["pan"], "position": ["0.1"]}, "not a JointState"),
        ({"position": [0.1]}, "not a JointState"),
    ],
)
def test_free_joints_that_are_not_all_there_are_refused_with_the_reason(head, message, why):
    with pytest.raises(NotTaken, match=why):
        head.drive_joints(message)


def test_a_twist_for_a_robot_without_a_base_is_refused_unless_it_is_zero(head):
    with pytest.raises(NotTaken, match="has no base"):
        head.drive({"linear": {"x": 0.1}, "angular": {"z": 0.0}})
    with pytest.raises(NotTaken, match=r"no lease|stood still"):
        head.drive({"linear": {"x": 0.0}, "angular": {"z": 0.0}})


@given(x=NUMBERS, z=NUMBERS, sec=NUMBERS, nanosec=NUMBERS)
def test_any_numbers_are_a_command_of_a_finite_age_or_refused(stamped, x, z, sec, nanosec):
    message = {
        "header": {"stamp": {"sec": sec, "nanosec": nanosec}},
        "twist": {"linear": {"x": x}, "angular": {"z": z}},
    }
    try:
        (linear_m_s, angular_rad_s, _), age_s = stamped._twist(message)
    except NotTaken:
        return
    assert 0.0 <= age_s <= OLD_S
    assert repr((linear_m_s, angular_rad_s)) == repr((float(x), float(z)))


def twist(age_s):
    sec, rest = divmod(time.time() - age_s, 1.0)
    return {
        "header": {"stamp": {"sec": int(sec), "nanosec": int(rest * 1e9)}},
        "twist": {"linear": {"x": 0.1}, "angular": {"z": -0.2}},
    }


def test_the_age_of_a_command_is_that_of_its_stamp(stamped):
    (linear_m_s, angular_rad_s, _), age_s = stamped._twist(twist(20.0))
    assert (linear_m_s, angular_rad_s) == (0.1, -0.2)
    assert age_s >= 20.0 - 1e-6


def test_a_clock_that_is_far_ahead_is_refused_and_one_that_is_a_little_ahead_is_not(stamped):
    with pytest.raises(NotTaken, match="clocks"):
        stamped._twist(twist(-3600.0))
    *_, age_s = stamped._twist(twist(-FUTURE_S / 2))
    assert age_s == 0.0


def test_a_command_without_a_stamp_is_refused_unless_the_robot_file_allows_it(stamped, unstamped):
    message = {"linear": {"x": 0.1}, "angular": {"z": math.nan}}
    with pytest.raises(NotTaken, match="no stamp"):
        stamped._twist(message)
    assert unstamped._twist(message)[0][0] == 0.1


def test_a_stamp_of_zero_counts_as_no_stamp(stamped, unstamped):
    message = {"header": {"stamp": {"sec": 0, "nanosec": 0}}, "name": [], "velocity": []}
    with pytest.raises(NotTaken, match="stamp is zero"):
        stamped._wheels(message)
    assert unstamped._wheels(message) == ([0.0, 0.0], 0.0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_velocity_of_a_joint_that_is_not_a_number_is_logged_once_with_its_sender(
    tmp_path_factory, value, caplog
):
    ours, stamp = gate(tmp_path_factory, stamped=True), {"sec": int(time.time()), "nanosec": 0}
    message = {"header": {"stamp": stamp}, "name": ["left", "right"], "velocity": [1.0, value]}
    for _ in range(100):
        with pytest.raises(NotTaken, match="no lease"):
            ours.drive_joints(message, sender=Sender("/panel", key=1))
    lines = [line for line in caplog.messages if "joint_commands" in line]
    assert lines == [
        "input.fleet: /panel requests by joint_commands what is not a number, so it counts as zero"
    ]


@pytest.mark.parametrize("topic", ["odom", "", "cmd_vel/"])
def test_other_topics_are_not_taken(unstamped, topic):
    with pytest.raises(NotTaken, match="there are: cmd_vel, joint_commands"):
        unstamped.take(topic, {})


@given(method=JSON)
async def test_an_unknown_call_is_refused(stamped, method):
    with pytest.raises(NotTaken, match="is not one of"):
        await stamped.act(method)


async def test_a_call_without_a_daemon_is_answered_with_the_reason(tmp_path_factory):
    fresh = gate(tmp_path_factory, lease_s=5.0)
    with pytest.raises(NotTaken, match="no daemon has this socket"):
        await fresh.act("arm")


@given(value=JSON)
def test_foreign_input_is_quoted_briefly_and_a_tag_only_where_it_is_plain(value):
    assert len(short(value)) <= 500
    assert tag(value) is None or tag(value) is value
