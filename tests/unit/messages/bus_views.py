# SPDX-License-Identifier: Apache-2.0
"""Views of a robot, at rest or with random data, for tests of the messages made from them."""

import dataclasses
import math
from types import SimpleNamespace

from motord.api.snapshot import GYRO_STATES, ImuSnapshot, JointSnapshot, Snapshot
from motord.bus.messages.forms import as_message
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import TOPICS, View

MS = 1_000_000
BODY = Body(robot="r2", joints=("left", "right"))


def as_object(value):
    """Return a message's dictionary as an object with the fields as attributes."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: as_object(part) for key, part in value.items()})
    return [as_object(part) for part in value] if isinstance(value, list) else value


def message(name, one, body, offset_ns):
    """Return a topic's message as an object, or None if the view `one` gives no message."""
    return as_object(as_message(TOPICS[name], body)(one, offset_ns))


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
            "pose_covariance": (0.0,) * 6, "twist_covariance": (0.0,) * 3,
            "lateral_covariance": (0.0,) * 3, "rest_unknown_since_ns": (0,) * 8,
            "counter_coarse": 0, "counter_distrusted": 0,
            "rest": "at_rest" if changes.get("at_rest") else "turning",
            "rest_unmeasured": 0}  # fmt: skip
    flags = dict.fromkeys(("armed", "enabled", "at_rest", "odometry_degraded"), False)
    return View(snapshot=Snapshot(**values | flags | rest | changes), status=status)


LOOP = {
    "rate_hz": 1.0, "policy": "SCHED_OTHER", "ticks": 1, "overruns": 0, "page_faults": 0,
    "lateness_us": dict.fromkeys(("p50", "p99", "p99_9", "max"), math.nan),
    "step_ns": dict.fromkeys(("p50", "p99", "p99_9", "max"), 1.0),
}  # fmt: skip
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


def any_imu(rng):
    """Return random data of a sensor that usually measures everything, or None."""
    if rng.random() < 0.1:
        return None
    vectors = ("angular_rad_s", "acceleration_m_s2")
    numbers = ("bias_rad_s", "bias_variance_rad2_s2", "rate_variance_rad2_s2")
    return dataclasses.replace(
        imu(rng.randrange(10**9)),
        state=rng.choice((*GYRO_STATES[1:], "used", "used", "state 9")),
        heading_by_gyro=rng.random() < 0.5, still=rng.random() < 0.5, refused=rng.randrange(9),
        **{name: tuple(seldom_odd(rng) for _ in range(3)) for name in vectors},
        **{name: seldom_odd(rng) for name in numbers},
    )  # fmt: skip


def seldom_odd(rng):
    return any_number(rng) if rng.random() < 0.1 else rng.gauss(0.0, 1.0)


def any_battery(rng):
    """Return a random battery in the form of the daemon's status, or None without one."""
    if rng.random() < 0.2:
        return None
    numbers = {
        name: rng.choice((None, any_number(rng), rng.gauss(0.0, 1.0)))
        for name in ("voltage_v", "current_a", "temperature_c", "capacity_ah")
    }
    state = rng.choice(("normal", "warning", "critical", "unknown"))
    stamp_ns = rng.choice((7, rng.randrange(10**9)))
    return {"state": state, **numbers, "stamp_ns": stamp_ns, "cells": rng.choice((None, 1, 2, 7))}


def any_loop(rng):
    """Return random figures of the loop in the form of the daemon's status."""
    percentiles = ("p50", "p99", "p99_9", "max")
    return {
        "rate_hz": any_number(rng), "policy": rng.choice(("SCHED_FIFO", "SCHED_OTHER", "")),
        **{key: rng.getrandbits(63) for key in ("ticks", "overruns", "page_faults")},
        "lateness_us": {name: any_number(rng) for name in percentiles},
        "step_ns": {name: any_number(rng) for name in percentiles},
    }  # fmt: skip


def any_view(rng, count):
    numbers = {name: any_number(rng) for name in (
        "x_m", "y_m", "heading_rad", "linear_m_s", "angular_rad_s", "command_age_s",
        "setpoint_linear_m_s", "setpoint_angular_rad_s")}  # fmt: skip
    lease = {"number": 1, "owner": rng.choice(("", "fleet")), "priority": rng.choice((0, 70)),
             "why": rng.choice(("", "in command: the only one"))}  # fmt: skip
    return view(
        rng.choice((0, 7, rng.randrange(10**9))),
        status={
            "leases": [lease], "loop": any_loop(rng), "battery": any_battery(rng),
            "why": list(any_words(rng)),
        },
        imu=any_imu(rng),
        machine_state=rng.randrange(12), owner=rng.choice((0, 1, 2)),
        armed=rng.random() < 0.5, at_rest=rng.random() < 0.5,
        rest=rng.choice(("unknown", "turning", "at_rest")),
        counter_coarse=0, counter_distrusted=0,
        rest_unknown_since_ns=tuple(rng.choice((0, rng.randrange(10**9))) for _ in range(8)),
        rest_unmeasured=rng.getrandbits(8),
        faults=any_words(rng), reasons=any_words(rng),
        joints=tuple(any_joint(rng) for _ in range(count)),
        pose_covariance=tuple(any_number(rng) for _ in range(6)),
        twist_covariance=tuple(any_number(rng) for _ in range(3)),
        **numbers,
    )  # fmt: skip


def any_body(rng, count):
    frames = {key: rng.choice(WORDS) for key in ("odom_frame", "base_frame")}
    return Body(robot="r2", joints=tuple(rng.choices(WORDS, k=count)), **frames)
