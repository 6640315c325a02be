# SPDX-License-Identifier: Apache-2.0
"""Views of a robot at rest, for tests of what is made of them."""

import dataclasses
import math

from motord.bus.messages import Body
from motord.bus.topics import View
from motord.snapshot import ImuSnapshot, JointSnapshot, Snapshot

MS = 1_000_000
BODY = Body(robot="r2", joints=("left", "right"))


def joint(**changes):
    plain = {field.name: 0.0 for field in dataclasses.fields(JointSnapshot)}
    words = {"enabled": True, "drive_faults": 0, "jumps": 0, "stale": False}
    return JointSnapshot(**plain | words | changes)


def imu(at_ms):
    nothing = {field.name: 0.0 for field in dataclasses.fields(ImuSnapshot)}
    vectors = dict.fromkeys(("angular_rad_s", "acceleration_m_s2"), (0.0, 0.0, 0.0))
    rest = {"stamp_ns": at_ms * MS, "state": "used", "heading_by_gyro": True, "still": True}
    return ImuSnapshot(**nothing | vectors | rest | {"refused": 0})


def view(at_ms, status=None, **changes):
    values = {field.name: 0.0 for field in dataclasses.fields(Snapshot)} | {"imu": imu(at_ms)}
    rest = {"stamp_ns": at_ms * MS, "odometry_stamp_ns": at_ms * MS, "machine_state": 2,
            "reasons": (), "faults": (), "joints": (joint(),) * 2, "owner": 0, "tick": 1,
            "pose_covariance": (0.0,) * 6, "twist_covariance": (0.0,) * 3}  # fmt: skip
    flags = dict.fromkeys(("armed", "enabled", "at_rest", "odometry_degraded"), False)
    return View(snapshot=Snapshot(**values | flags | rest | changes), status=status)


LOOP = {
    "rate_hz": 1.0, "policy": "SCHED_OTHER", "ticks": 1, "overruns": 0, "page_faults": 0,
    "lateness_us": dict.fromkeys(("p50", "p99", "p99_9", "max"), math.nan),
    "step_ns": dict.fromkeys(("p50", "p99", "p99_9", "max"), 1.0),
}  # fmt: skip
