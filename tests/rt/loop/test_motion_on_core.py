# SPDX-License-Identifier: Apache-2.0
"""Motions over a given distance, on the real core: its limits, its ramps, its odometry."""

import math
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rt.core_rig import Rig, core_config

from motord.api.motion import Bounds, End, Goal, Motion, planned
from motord.realtime.loop import _snapshot

LEASE, STALE_S, LOOK_TICKS = 3, 0.25, 20
TICKS_MAX = 200_000


class Drive:
    """An armed core, and a motion that sees each state of it `looks_late` looks later."""

    def __init__(self, limits, goal, looks_late):
        self.rig = Rig(core_config(limits={"lateral": limits["linear"], **limits}))
        self.rig.input.control.owner = LEASE
        self.rig.arm()
        bounds = Bounds(**limits[goal.axis])
        self._seen = deque([self.snapshot()] * (looks_late + 1), looks_late + 1)
        self.motion = Motion(
            planned(goal, bounds),
            self._seen[0],
            self.rig.input.now_ns,
            lease=LEASE,
            stale_s=STALE_S,
            stops=0,
        )
        self.fastest_u_s = 0.0

    def snapshot(self):
        return _snapshot(self.rig.shown)

    def to_its_end(self):
        for tick in range(TICKS_MAX):
            if tick % LOOK_TICKS == 0:
                self._seen.append(self.snapshot())
                self.motion.counted(0, self.rig.input.now_ns)
                step = self.motion.step(self._seen[0], self.rig.input.now_ns)
                if step.end is not None:
                    return step
                self.rig.drive(step.linear_m_s, step.angular_rad_s)
            shown = self.rig.tick()
            speed_u_s = abs(shown.setpoint_linear_m_s) + abs(shown.setpoint_angular_rad_s)
            self.fastest_u_s = max(self.fastest_u_s, speed_u_s)
        raise AssertionError("it has no end")


def axis(velocity_u_s, acceleration_u_s2, deceleration_u_s2, jerk_u_s3):
    return {
        "velocity_u_s": velocity_u_s,
        "acceleration_u_s2": acceleration_u_s2,
        "deceleration_u_s2": deceleration_u_s2,
        "jerk_u_s3": jerk_u_s3,
    }


AXES = st.builds(
    axis,
    st.floats(0.1, 1.2),
    st.floats(0.2, 3.0),
    st.floats(0.2, 3.0),
    st.sampled_from([math.inf, 20.0, 5.0, 1.0]),
)


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(["linear", "angular"]),
    limits=AXES,
    distance_u=st.sampled_from([0.1, 0.5, 2.0, -0.3, -1.5]),
    looks_late=st.integers(0, 4),
)
def test_it_ends_at_the_goal_and_within_the_limits(name, limits, distance_u, looks_late):
    both = {"linear": axis(1.0, 1.0, 1.0, math.inf), "angular": axis(1.0, 1.0, 1.0, math.inf)}
    drive = Drive(both | {name: limits}, Goal(axis=name, distance_u=distance_u), looks_late)
    step = drive.to_its_end()
    assert (step.end, step.why) == (End.SUCCEEDED, "")
    drive.rig.drive(0.0)
    shown = drive.rig.ticks(0.1)
    assert shown.at_rest
    assert drive.fastest_u_s <= limits["velocity_u_s"] * (1.0 + 1e-9)
    done_u = shown.x_m if name == "linear" else shown.heading_rad
    assert done_u == pytest.approx(distance_u, abs=drive.motion.plan.tolerance_u)


def test_an_emergency_stop_ends_it_while_the_core_brings_the_base_to_rest():
    limits = {"linear": axis(0.5, 1.0, 1.0, math.inf), "angular": axis(1.0, 1.0, 1.0, math.inf)}
    drive = Drive(limits, Goal(axis="linear", distance_u=50.0), 1)
    tick = drive.rig.tick

    def stopped(*args):
        drive.rig.input.control.estop = drive.rig.input.now_ns > 2_000_000_000
        return tick(*args)

    drive.rig.tick = stopped
    step = drive.to_its_end()
    assert step.end is End.ABORTED
    assert "estop" in step.why
    assert (step.linear_m_s, step.angular_rad_s) == (0.0, 0.0)
    assert drive.rig.ticks(0.1).at_rest
