# SPDX-License-Identifier: Apache-2.0
"""The robot state from the C struct to plain values to JSON: every field arrives, and no number
that JSON does not have."""

import dataclasses
import json
import math
import subprocess
import sys

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st

from motord.api.records import LateralSnapshot, RestSnapshot, SteeringSnapshot
from motord.api.snapshot import (
    DERATED_BY,
    SNAPSHOT_VERSION,
    DeratingSnapshot,
    DoubtSnapshot,
    ImuSnapshot,
    JointSnapshot,
    Rest,
    Snapshot,
    SpeedLoopSnapshot,
)
from motord.api.words import FAULTS, REASONS
from motord.realtime import loop as rt

any_float = st.floats(allow_nan=True, allow_infinity=True)


def c_fields(struct_name):
    return [name for name, _ in ffi.typeof(struct_name).fields]


def python_fields(kind):
    return [field.name for field in dataclasses.fields(kind)]


APART = {
    *(
        "joint",
        "imu",
        "doubt",
        "lateral",
        "steering",
        "speed_loop",
        "derating",
        "reason",
        "rest",
        "counters",
    )
}
"""Fields of robot_state that are structures."""


def raw_state():
    """Return a state with another number in each field, so that swapped fields show."""
    raw = ffi.new("robot_state *")
    for number, name in enumerate(c_fields("robot_state"), 1000):
        if name.endswith("covariance"):
            setattr(raw, name, [number * 10 + i for i in range(len(getattr(raw, name)))])
        elif name not in APART:
            setattr(raw, name, number)
    raw.reasons = lib.REASON_LINEAR_JERK | lib.REASON_COMMAND_STALE
    raw.faults = lib.FAULT_ESTOP | lib.FAULT_STATE
    raw.joint_count = 3
    for index in range(3):
        for number, name in enumerate(c_fields("joint_state"), 5000 + 100 * index):
            setattr(raw.joint[index], name, number)
    for number, name in enumerate(c_fields("imu_state"), 7000):
        vector = name in ("angular_rad_s", "acceleration_m_s2")
        setattr(raw.imu, name, [number * 10 + i for i in range(3)] if vector else number)
    raw.imu.state = lib.GYRO_USED
    for number, name in enumerate(c_fields("feedback_doubt"), 8000):
        setattr(raw.doubt, name, number)
    raw.doubt.fault = lib.FAULT_STALL
    for number, name in enumerate(c_fields("lateral_state"), 9000):
        vector = name == "lateral_covariance"
        setattr(raw.lateral, name, [number * 10 + i for i in range(3)] if vector else number)
    for number, name in enumerate(c_fields("steering_state"), 9500):
        vector = name == "position_setpoints_rad"
        setattr(raw.steering, name, [number * 10 + i for i in range(8)] if vector else number)
    for index in range(3):
        raw.speed_loop[index] = {"output_u": 9100 + index, "integral_u": 9200 + index}
    raw.derating = {"since_ns": 9300, "factor": 0.5, "joint": 1, "by": lib.DERATED_BY_VOLTAGE}
    raw.rest = {"rest": lib.REST_AT_REST, "rest_unmeasured": 9600}
    raw.rest.rest_unknown_since_ns = list(range(9610, 9618))
    raw.counters = {"counter_coarse": 9700, "counter_distrusted": 9701}
    raw.reason.since_ns = list(range(9400, 9432))
    raw.reason.saturated_joint = 2
    for place, name in enumerate(JOINT_REASONS):
        setattr(raw.reason, name, 1 << place)
    return raw


JOINT_REASONS = [
    "duty_clamped",
    "duty_slew",
    "joint_velocity",
    "joint_acceleration",
    "joint_position",
]


def test_the_names_are_those_of_the_c_struct():
    expected = set(c_fields("robot_state")) - {"joint_count", *APART}
    ours = {"joints", "speed_loops", "version", "imu", "doubt", "derating"}
    ours |= {*c_fields("lateral_state"), *c_fields("steering_state"), *c_fields("rest_shown")}
    ours |= {*c_fields("counters_shown")}
    ours |= {"reasons_since_ns", "saturated_joint", "reason_joints"}
    assert set(python_fields(Snapshot)) == expected | ours
    assert python_fields(SpeedLoopSnapshot) == c_fields("speed_loop_shown")
    assert python_fields(DeratingSnapshot) == c_fields("derating_shown")
    assert c_fields("reasons_shown") == ["since_ns", "saturated_joint", *JOINT_REASONS]
    assert list(LateralSnapshot.__annotations__) == c_fields("lateral_state")
    assert list(SteeringSnapshot.__annotations__) == c_fields("steering_state")
    assert list(RestSnapshot.__annotations__) == c_fields("rest_shown")
    assert python_fields(JointSnapshot) == c_fields("joint_state")
    assert python_fields(ImuSnapshot) == c_fields("imu_state")
    assert python_fields(DoubtSnapshot) == c_fields("feedback_doubt")


def test_every_field_arrives_in_its_place():
    raw = raw_state()
    made = rt._snapshot(raw)
    assert (made.reasons, made.faults) == (("linear_jerk", "command_stale"), ("estop", "state"))
    apart = {"joints", "speed_loops", "version", "reasons", "faults", "imu", "doubt", "derating"}
    apart |= {"reasons_since_ns", "saturated_joint", "reason_joints", "rest"}
    where = dict.fromkeys(c_fields("lateral_state"), raw.lateral)
    where |= dict.fromkeys(c_fields("steering_state"), raw.steering)
    where |= dict.fromkeys(c_fields("rest_shown"), raw.rest)
    where |= dict.fromkeys(c_fields("counters_shown"), raw.counters)
    for name in set(python_fields(Snapshot)) - apart:
        value = getattr(made, name)
        assert value == type(value)(getattr(where.get(name, raw), name)), name
    assert len(made.joints) == 3
    for index, joint in enumerate(made.joints):
        for name in python_fields(JointSnapshot):
            value = getattr(joint, name)
            assert value == type(value)(getattr(raw.joint[index], name)), name
    assert made.speed_loops == tuple(
        SpeedLoopSnapshot(output_u=9100 + index, integral_u=9200 + index) for index in range(3)
    )
    assert made.derating == DeratingSnapshot(since_ns=9300, factor=0.5, joint=1, by="voltage")
    assert made.reasons_since_ns == {word: 9400 + bit for bit, word in REASONS.items()}
    assert made.saturated_joint is None
    assert made.rest is Rest.AT_REST
    for name in set(python_fields(ImuSnapshot)) - {"state"}:
        value = getattr(made.imu, name)
        assert value == type(value)(getattr(raw.imu, name)), name
    assert made.doubt.fault == "stall"
    for name in set(python_fields(DoubtSnapshot)) - {"fault"}:
        assert getattr(made.doubt, name) == getattr(raw.doubt, name), name


def test_a_wheel_is_named_while_it_is_saturated_and_derating_is_empty_without_one():
    raw = raw_state()
    raw.reasons = lib.REASON_WHEEL_SATURATED
    raw.reason.since_ns = [0] * lib.REASONS_MAX
    raw.reason.since_ns[8] = 77
    raw.derating.since_ns = 0
    made = rt._snapshot(raw)
    assert made.saturated_joint == 2
    assert made.reasons_since_ns == {"wheel_saturated": 77}
    assert made.derating is None
    assert len(DERATED_BY) == lib.DERATINGS


@pytest.mark.parametrize("place", range(len(JOINT_REASONS)))
def test_the_joints_of_a_reason_are_named_while_it_holds(place):
    raw = raw_state()
    raw.joint_count = 8
    for number, name in enumerate(JOINT_REASONS):
        setattr(raw.reason, name, 0b10000001 << number & 0xFF)
    word = JOINT_REASONS[place]
    assert rt._snapshot(raw).reason_joints == {}
    raw.reasons = 1 << {name: bit for bit, name in REASONS.items()}[word]
    named = (0, 7) if place == 0 else (place,)
    assert rt._snapshot(raw).reason_joints == {word: named}
    assert rt._snapshot(raw).to_json()["reason_joints"] == {word: list(named)}


def test_joints_whose_position_is_not_known_are_named():
    raw = raw_state()
    raw.reasons = lib.REASON_POSITION_UNKNOWN
    raw.steering.position_unknown = 0b110
    assert rt._snapshot(raw).reason_joints == {"position_unknown": (1, 2)}


def test_without_a_fault_of_the_feedback_no_joint_is_doubted():
    raw = raw_state()
    raw.doubt.fault = 0
    assert rt._snapshot(raw).doubt is None


def test_every_value_of_rest_has_its_word():
    numbers = {name: getattr(lib, name) for name in dir(lib) if name.startswith("REST_")}
    raw = raw_state()
    for name, number in numbers.items():
        raw.rest.rest = number
        assert rt._snapshot(raw).rest is Rest[name.removeprefix("REST_")]
    assert len(numbers) == len(Rest)


def test_every_state_of_the_gyro_has_its_word_and_the_imu_is_empty_without_a_gyro():
    raw, words = raw_state(), []
    numbers = {name: getattr(lib, name) for name in dir(lib) if name.startswith("GYRO_")}
    for number in sorted(numbers.values()):
        raw.imu.state = number
        made = rt._snapshot(raw).imu
        words.append("none" if made is None else made.state)
    assert words == ["none", "unbiased", "used", "stale", "reversed"]
    assert len(words) == len(numbers)


FLAGS = ("armed", "enabled", "at_rest", "odometry_degraded")


@pytest.mark.parametrize("flag", FLAGS)
def test_each_flag_is_set_independently_of_the_others(flag):
    raw = ffi.new("robot_state *")
    setattr(raw, flag, 1)
    made = rt._snapshot(raw)
    assert [name for name in FLAGS if getattr(made, name)] == [flag]


@pytest.mark.parametrize(("reported", "meant"), [(0, False), (1, True), (2, None)])
def test_a_drive_that_cannot_report_whether_it_is_enabled_is_not_called_enabled(reported, meant):
    raw = raw_state()
    raw.joint[1].enabled = reported
    assert rt._snapshot(raw).joints[1].enabled is meant


@given(st.lists(any_float, min_size=60, max_size=60))
def test_json_never_holds_nan_or_infinity(values):
    raw, supply = raw_state(), iter(values)
    for name, field in ffi.typeof("robot_state").fields:
        if field.type.cname == "double":
            setattr(raw, name, next(supply))
        elif field.type.cname.startswith("double["):
            setattr(raw, name, [next(supply) for _ in getattr(raw, name)])
    for name in ("velocity_rad_s", "current_a", "feedback_age_s"):
        setattr(raw.joint[0], name, next(supply))
    snapshot = rt._snapshot(raw)
    read = json.loads(json.dumps(snapshot.to_json(), allow_nan=False))
    assert read == snapshot.to_json()
    for name in ("x_m", "command_age_s", "saturation"):
        value = getattr(snapshot, name)
        assert read[name] == (value if math.isfinite(value) else None)
    current_a = snapshot.joints[0].current_a
    assert read["joints"][0]["current_a"] == (current_a if math.isfinite(current_a) else None)


def test_json_has_words_lists_and_its_version():
    raw = raw_state()
    read = rt._snapshot(raw).to_json()
    assert read["reasons"] == ["linear_jerk", "command_stale"]
    assert read["faults"] == ["estop", "state"]
    assert read["version"] == SNAPSHOT_VERSION == 2
    assert [joint["jumps"] for joint in read["joints"]] == [raw.joint[n].jumps for n in range(3)]
    assert len(read["pose_covariance"]) == 6


def test_a_snapshot_does_not_change():
    snapshot = rt._snapshot(raw_state())
    with pytest.raises(dataclasses.FrozenInstanceError):
        snapshot.x_m = 0.0


@pytest.mark.parametrize(("words", "prefix"), [(REASONS, "REASON_"), (FAULTS, "FAULT_")])
def test_every_bit_of_the_core_has_its_word(words, prefix):
    bits = {name: getattr(lib, name) for name in dir(lib) if name.startswith(prefix)}
    assert {f"{prefix}{word.upper()}": 1 << bit for bit, word in words.items()} == bits


def test_the_reasons_to_stand_are_all_reasons_but_limits():
    names = [name for name in dir(lib) if name.startswith("REASON_")]
    limits = 0xFFFF | lib.REASON_STEERING | lib.REASON_CURVATURE | lib.REASON_TURN_IMPOSSIBLE
    limits |= lib.REASON_DERATED | lib.REASON_JOINT_VELOCITY | lib.REASON_JOINT_ACCELERATION
    limits |= lib.REASON_JOINT_POSITION
    standing = [getattr(lib, name) for name in names if not getattr(lib, name) & limits]
    assert sum(standing) == lib.REASONS_TO_STAND


def test_the_second_process_reads_snapshots_without_the_c_core():
    program = "import sys, motord.api.snapshot; sys.exit('_motord_rt' in sys.modules)"
    subprocess.run(
        [sys.executable, "-c", program],
        check=True,
        timeout=60,
        env={"PYTHONPATH": ":".join(filter(None, sys.path))},
    )
