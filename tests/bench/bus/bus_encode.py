# SPDX-License-Identifier: Apache-2.0
"""Time from a snapshot to bytes by topic: CDR for ROS 2, JSON for MQTT and rosbridge; compared in
turns with the encoder of the Cyclone DDS binding and with the standard library's json.

python bus_encode.py [ROUNDS]: prints one JSON object, µs a message, each the best of its rounds.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
import timeit
from collections.abc import Callable
from typing import Any

from motord.api.snapshot import ImuSnapshot, JointSnapshot, Snapshot
from motord.bus.messages import json_form
from motord.bus.messages.forms import as_cdr, as_json, as_message
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import TOPICS, View

OFFSET_NS = 1_790_000_000_000_000_000
BODY = Body(robot="bench", joints=("left", "right"))
CALLS = 2000


def joint(turned_rad: float) -> JointSnapshot:
    unknown = {key.name: math.nan for key in dataclasses.fields(JointSnapshot)}
    return JointSnapshot(**unknown | {
        "position_rad": turned_rad, "velocity_rad_s": 4.0 / 3.0, "setpoint_rad_s": 1.3,
        "current_a": 0.77, "voltage_v": 24.1, "feedback_age_s": 0.0041,
        "drive_faults": 0, "enabled": True, "stale": False, "jumps": 0,
    })  # fmt: skip


def imu() -> ImuSnapshot:
    return ImuSnapshot(
        stamp_ns=90_122_987_654, angular_rad_s=(0.01 / 3, -0.02 / 3, 0.0913),
        acceleration_m_s2=(0.1 / 3, 0.2 / 3, 9.81), bias_rad_s=1e-3 / 3,
        bias_variance_rad2_s2=1e-7 / 3, rate_variance_rad2_s2=1e-5 / 3, state="used",
        heading_by_gyro=True, still=False, refused=0,
    )  # fmt: skip


def moving() -> View:
    """Return the view of a moving base, with numbers that are not round."""
    snapshot = Snapshot(
        stamp_ns=90_123_456_789, tick=90_123, machine_state=4, owner=1, reasons=("linear_jerk",),
        faults=(), armed=True, enabled=True, at_rest=False, odometry_degraded=False,
        odometry_epoch=0, dt_s=0.001, command_age_s=0.0123, wanted_linear_m_s=0.4,
        wanted_angular_rad_s=0.1, setpoint_linear_m_s=1 / 3, setpoint_angular_rad_s=1 / 11,
        saturation=1.0, odometry_stamp_ns=90_121_345_678, x_m=math.pi, y_m=-math.e,
        heading_rad=0.7, distance_m=12.34, turned_rad=2.2, linear_m_s=0.3331, angular_rad_s=0.0913,
        pose_covariance=(0.1 / 3, 0.2 / 3, 0.3 / 7, 0.4 / 3, 0.5 / 7, 0.6 / 7),
        twist_covariance=(1e-4 / 3, 1e-5 / 3, 1e-4 / 7), joints=(joint(12.3456), joint(-3.21)),
        imu=imu(), wanted_lateral_m_s=0.0, setpoint_lateral_m_s=0.0, lateral_m_s=0.0, slip_m_s=1e-4,
        lateral_covariance=(0.0, 0.0, 0.0), position_setpoints_rad=(math.nan,) * 8,
        misaligned_rad=0.0, position_joints=0, position_unknown=0, rest="turning",
        rest_unknown_since_ns=(0,) * 8, rest_unmeasured=0,
        counter_coarse=0, counter_distrusted=0,
    )  # fmt: skip
    late = dict.fromkeys(("p50", "p99", "p99_9", "max"), 12.5)
    loop = {"rate_hz": 1000.0, "policy": "SCHED_FIFO", "ticks": 1, "overruns": 0, "page_faults": 0,
            "lateness_us": late, "step_ns": late}  # fmt: skip
    battery = {"state": "normal", "voltage_v": 24.31, "current_a": -1.27, "temperature_c": None,
               "stamp_ns": 1, "age_s": 0.4, "cells": 7, "capacity_ah": 10.0}  # fmt: skip
    leases = ({"number": 1, "owner": "fleet", "priority": 70, "why": "in command: the only one"},)
    status = {"loop": loop, "leases": leases, "battery": battery}
    return View(snapshot=snapshot, status=status, status_ns=1)


def cyclone(topic: str) -> Callable[[], Any]:
    """Return a function that serializes the topic's message with the Cyclone DDS binding."""
    from motord.bus.messages.table import TYPES
    from motord.bus.ros2.dds.cyclone_types import cyclone_type

    view, offset_ns = moving(), OFFSET_NS

    def made(name: str, value: Any) -> Any:
        fields = {}
        for field in TYPES[name]:
            item = value[field.name] if isinstance(value, dict) else getattr(value, field.name)
            if field.count is None:
                item = item if field.primitive else made(field.kind, item)
            elif not field.primitive:
                item = [made(field.kind, part) for part in item]
            else:
                item = list(item)
            fields[field.name] = item
        return cyclone_type(name)(**fields)

    chosen = TOPICS[topic]
    message = made(chosen.type_name, as_message(chosen, BODY)(view, offset_ns))
    return lambda: message.serialize(use_version_2=False)


def forms_of(topic: str) -> dict[str, Callable[[], Any]]:
    view, offset_ns, chosen = moving(), OFFSET_NS, TOPICS[topic]
    cdr, text = as_cdr(chosen, BODY), as_json(chosen, BODY)
    build = as_message(chosen, BODY)
    return {
        "cdr": lambda: cdr(view, offset_ns),
        "cdr, cyclone": cyclone(topic),
        "json": lambda: text(view, offset_ns),
        "json, stdlib": lambda: json_form.encode_slowly(build(view, offset_ns)),
    }


def measure(rounds: int) -> dict[str, dict[str, float]]:
    """Return µs a message, by topic and form; forms take turns and each keeps its best round."""
    view = moving()
    sent = [name for name, topic in TOPICS.items() if as_message(topic, BODY)(view, 0) is not None]
    all_forms = {topic: forms_of(topic) for topic in sent}
    best = {topic: dict.fromkeys(found, math.inf) for topic, found in all_forms.items()}
    for _ in range(rounds):
        for topic, found in all_forms.items():
            for name, call in found.items():
                one_us = timeit.timeit(call, number=CALLS) / CALLS * 1e6
                best[topic][name] = min(best[topic][name], one_us)
    return best


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]) if len(sys.argv) > 1 else 7)))
