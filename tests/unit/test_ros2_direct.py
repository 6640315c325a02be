# SPDX-License-Identifier: Apache-2.0
"""The short way from a snapshot to CDR says what the long way says, byte for byte."""

import math
import random

import pytest
from tests.unit.bus_views import LOOP, joint, view

from motord.bus.messages import Body
from motord.bus.ros2 import cdr, direct
from motord.bus.topics import TOPICS, View

OFFSET_NS = 1_700_000_000_000_000_000
ROUNDS = 150
NUMBERS = (0.0, -0.0, 1e-320, 1e308, -1e308, math.inf, -math.inf, math.nan)
WORDS = ("", "a", "linear_jerk", "Räder", "estop")


def any_number(rng):
    return rng.choice(NUMBERS) if rng.random() < 0.1 else rng.gauss(0.0, 10.0)


def any_words(rng):
    return tuple(rng.choice(WORDS) for _ in range(rng.choice((0, 0, 1, 2))))


def any_joint(rng):
    numbers = {name: any_number(rng) for name in (
        "position_rad", "velocity_rad_s", "setpoint_rad_s", "duty", "current_a", "voltage_v",
        "temperature_c")}  # fmt: skip
    age_s = rng.choice((rng.random(), rng.random(), 1e30, math.inf))
    return joint(**numbers, feedback_age_s=age_s, drive_faults=rng.getrandbits(32),
                 stale=rng.random() < 0.5)  # fmt: skip


def any_view(rng, count):
    numbers = {name: any_number(rng) for name in (
        "x_m", "y_m", "heading_rad", "linear_m_s", "angular_rad_s", "command_age_s",
        "setpoint_linear_m_s", "setpoint_angular_rad_s")}  # fmt: skip
    lease = {"number": 1, "owner": rng.choice(("", "fleet")), "priority": rng.choice((0, 70))}
    return view(
        rng.choice((0, 7, rng.randrange(10**9))),
        status={"leases": [lease], "loop": LOOP},
        machine_state=rng.randrange(12), owner=rng.choice((0, 1, 2)),
        armed=rng.random() < 0.5, at_rest=rng.random() < 0.5,
        faults=any_words(rng), reasons=any_words(rng),
        joints=tuple(any_joint(rng) for _ in range(count)),
        pose_covariance=tuple(any_number(rng) for _ in range(6)),
        twist_covariance=tuple(any_number(rng) for _ in range(3)),
        **numbers,
    )  # fmt: skip


def outcome(encode, one):
    try:
        return encode(one, OFFSET_NS)
    except ValueError:
        return "refused"


@pytest.mark.parametrize("name", sorted(TOPICS))
def test_it_says_what_the_message_says_byte_for_byte(name):
    """Several views one after the other: what is kept from one may not show in the next."""
    topic, rng = TOPICS[name], random.Random(name)
    said = 0
    for _ in range(ROUNDS):
        count = rng.choice((0, 1, 2, 2, 4, 5))
        frames = {key: rng.choice(WORDS) for key in ("odom_frame", "base_frame")}
        body = Body(robot="r2", joints=tuple(rng.choices(WORDS, k=count)), **frames)

        def long_way(one, offset_ns, body=body):
            message = topic.build(one, body, offset_ns)
            return None if message is None else bytes(cdr.encode(topic.type_name, message))

        short_way = direct.encoder(topic, body)
        for _ in range(3):
            one = any_view(rng, count)
            expected = outcome(long_way, one)
            said += isinstance(expected, bytes)
            assert outcome(short_way, one) == expected
    assert said > ROUNDS


@pytest.mark.parametrize("name", ["odom", "tf", "joint_states", "motor_status"])
def test_the_usual_case_builds_no_message(name, monkeypatch):
    body = Body(robot="r2", joints=("left", "right"))
    built = []
    topic = TOPICS[name]
    plain = type(topic)(name=name, type_name=topic.type_name, message=topic.message,
                        build=lambda *words: built.append(words))  # fmt: skip
    assert direct.encoder(plain, body)(view(5, x_m=1.0), OFFSET_NS)
    assert not built


@pytest.mark.parametrize("name", sorted(TOPICS))
def test_a_stamp_is_read_from_the_bytes_as_the_message_has_it(name):
    body = Body(robot="r2", joints=("left", "right"))
    joints = (joint(voltage_v=24.0),) * 2
    one = View(snapshot=view(7, joints=joints).snapshot,
               status={"leases": (), "loop": LOOP}, status_ns=9)  # fmt: skip
    message = TOPICS[name].build(one, body, OFFSET_NS)
    raw = direct.encoder(TOPICS[name], body)(one, OFFSET_NS)
    stamp = (message.transforms[0] if name == "tf" else message).header.stamp
    assert direct.stamp_ns(name, raw) == stamp.sec * 10**9 + stamp.nanosec


@pytest.mark.parametrize("name", ["odom", "tf", "joint_states", "motor_status"])
def test_a_stamp_that_the_message_cannot_hold_is_refused(name):
    body = Body(robot="r2", joints=("left", "right"))
    with pytest.raises(ValueError, match=TOPICS[name].type_name):
        direct.encoder(TOPICS[name], body)(view(5, x_m=math.pi), 2**31 * 10**9)
