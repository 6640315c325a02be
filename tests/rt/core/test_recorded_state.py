# SPDX-License-Identifier: Apache-2.0
"""What a recording holds of the core is checked before the core gets it: each state and input that
a core can have is accepted, and no other one moves a single index out of its range."""

import math
from pathlib import Path

import pytest
from _motord_rt import lib
from tests.rt.core_walk import Walk, raw_bytes

from motord.config import load_robot
from motord.control.assembly import core_config
from motord.realtime.recorded import Damaged, checked_input, checked_state
from motord.realtime.replay import ReplayedCore

ROBOTS = {
    path.stem: path
    for path in sorted((Path(__file__).resolve().parents[3] / "config/robots").glob("*.toml"))
}
TICKS = 150
FLIPS = 100


def config_of(name):
    robot = load_robot(ROBOTS[name])
    return core_config(robot, robot.profiles)


@pytest.fixture(params=sorted(ROBOTS))
def config(request):
    return config_of(request.param)


def test_every_state_that_a_core_has_is_accepted(config):
    walk = Walk(config, seed=1)
    for _ in range(TICKS):
        checked_state(walk.initial, raw_bytes(walk.state))
        walk.step()


@pytest.mark.parametrize("name", ["demo", "swerve4-can", "pan-tilt"])
def test_a_state_at_rest_and_one_whose_feedback_is_not_trusted_are_accepted(name):
    walk = Walk(config_of(name), seed=1)
    walk.step()
    for rest in (lib.REST_UNKNOWN, lib.REST_TURNING, lib.REST_AT_REST):
        walk.state.rest = walk.state.joints_rest = walk.state.snapshot.rest.rest = rest
        walk.state.doubted = (1 << lib.JOINTS_MAX) - 1
        checked_state(walk.initial, raw_bytes(walk.state))
    walk.state.rest = lib.REST_AT_REST + 1
    with pytest.raises(Damaged, match="rest is 3"):
        checked_state(walk.initial, raw_bytes(walk.state))


def test_a_state_with_flipped_bits_is_refused_or_steps_as_any_other(config):
    walk = Walk(config, seed=2)
    for _ in range(100):
        walk.step()
    good, record = raw_bytes(walk.state), raw_bytes(walk.record)
    core, refused = ReplayedCore(config), 0
    for _ in range(FLIPS):
        changed = bytearray(good)
        for _ in range(walk.dice.randint(1, 3)):
            changed[walk.dice.randrange(len(changed))] ^= 1 << walk.dice.randrange(8)
        try:
            core.load(bytes(changed))
        except Damaged:
            refused += 1
            continue
        for _ in range(3):
            core.step(record)
    assert 0 < refused < FLIPS


def test_a_replayed_core_is_the_recorded_one(config):
    walk, core = Walk(config, seed=3), ReplayedCore(config)
    for _ in range(50):
        walk.step()
    core.load(raw_bytes(walk.state))
    for _ in range(50):
        walk.step()
        core.step(raw_bytes(walk.record))
        assert core.is_at(raw_bytes(walk.state))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("config.module_count", 9),
        ("config.joint_count", 4096),
        ("axes", 77),
        ("stale", [2] + [0] * 7),
        ("tick", 1 << 63),
        ("armed_ns", -1),
        ("odometry.heading_rad", 1e300),
        ("odometry.x_m", math.nan),
        ("odometry.used.joints", 256),
        ("snapshot.doubt.joint", 8),
    ],
)
def test_a_number_that_no_core_has_is_refused_by_its_name(field, value):
    config = config_of("demo")
    walk = Walk(config, seed=4)
    *path, last = field.split(".")
    place = walk.state
    for part in path:
        place = getattr(place, part)
    setattr(place, last, value)
    with pytest.raises(Damaged, match=field):
        ReplayedCore(config).load(raw_bytes(walk.state))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda record: setattr(record, "dt_s", math.nan), "dt_s"),
        (lambda record: setattr(record, "dt_s", -1.0), "dt_s"),
        (lambda record: setattr(record.input, "now_ns", -(1 << 63)), "now_ns"),
        (lambda record: setattr(record.input.control, "armed", 7), "armed"),
        (lambda record: setattr(record.input.feedback[3], "enabled", 3), "enabled"),
    ],
)
def test_input_that_no_core_gets_is_refused_by_its_name(change, field):
    walk = Walk(config_of("demo"), seed=5)
    walk.step()
    change(walk.record)
    with pytest.raises(Damaged, match=field):
        checked_input(raw_bytes(walk.record))
