# SPDX-License-Identifier: Apache-2.0
"""Makes Prometheus figures from a view: base units and names by its conventions, one family after
the other (prometheus.io/docs/practices/naming). What was not measured is NaN, which the format
has."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from prometheus_client import CollectorRegistry, Metric, generate_latest
from prometheus_client.registry import Collector

from motord.api.snapshot import STATES, Rest, rest_report, stamp_is_fresh
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import View

Labels = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Family:
    """A figure and its values by labels."""

    name: str
    kind: str
    """Type of the figure: "gauge" or "counter"."""
    text: str
    values: tuple[tuple[Labels, float], ...]


class _Figures(Collector):
    def __init__(self, body: Body, view: View | None) -> None:
        self._body = body
        self._view = view

    def collect(self) -> Iterator[Metric]:
        """Yield all figures; of a loop that does not run only those that the daemon reports."""
        for family in _families(self._body, self._view):
            metric = Metric(family.name.removesuffix("_total"), family.text, family.kind)
            for labels, value in family.values:
                metric.add_sample(family.name, {"robot": self._body.robot, **labels}, value)
            yield metric


def exposition(body: Body, view: View | None) -> bytes:
    """Return the figures as the text of an answer."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Figures(body, view))
    return generate_latest(registry)


def _families(body: Body, view: View | None) -> Iterator[Family]:
    up = view is not None and _is_up(view)
    yield Family("motord_up", "gauge", "1: the robot's loop runs.", (({}, float(up)),))
    if view is None:
        return
    if up:
        yield from _base(view)
        yield from _joints(body, view)
        yield from _rest(body, view)
    if view.status is not None:
        yield from _loop(view.status)
        yield from _lines(view.status)
        yield from _commands(view.status)
        yield from _battery(view.battery())


STALE_S = 1.0
"""Age of a snapshot from which on the loop counts as not running. What such a snapshot shows of the
robot is not exported: a monitor would take an old speed for the present one."""


def _is_up(view: View) -> bool:
    return stamp_is_fresh(time.monotonic_ns(), view.snapshot.stamp_ns, STALE_S)


def _base(view: View) -> Iterator[Family]:
    now = view.snapshot
    states = tuple(
        ({"state": word}, float(number == now.machine_state)) for number, word in enumerate(STATES)
    )
    yield Family("motord_state", "gauge", "1 for the state machine's state.", states)
    rests = tuple(({"rest": word.value}, float(word == now.rest)) for word in Rest)
    yield Family("motord_rest", "gauge", "1 for what is known of the robot's rest.", rests)
    gauges = {
        "armed": ("Whether the core is armed.", float(now.armed)),
        "faults": ("Faults that are latched.", float(len(now.faults))),
        "command_age_seconds": ("Age of the newest command.", now.command_age_s),
        "speed_metres_per_second": ("Measured speed.", now.linear_m_s),
        "turn_rate_radians_per_second": ("Measured turn rate.", now.angular_rad_s),
        "setpoint_metres_per_second": ("Requested speed.", now.setpoint_linear_m_s),
        "setpoint_radians_per_second": (
            "Requested turn rate.",
            now.setpoint_angular_rad_s,
        ),
        "odometry_degraded": (
            "Whether a wheel is missing in the odometry.",
            float(now.odometry_degraded),
        ),
    }
    for name, (text, value) in gauges.items():
        yield Family(f"motord_{name}", "gauge", text, (({}, value),))
    yield Family("motord_ticks_total", "counter", "Ticks of the loop.", (({}, now.tick),))
    yield Family(
        "motord_distance_metres_total", "counter", "Distance driven.", (({}, now.distance_m),)
    )


def _joints(body: Body, view: View) -> Iterator[Family]:
    figures = {
        "velocity_radians_per_second": ("Measured speed of the wheel.", "velocity_rad_s"),
        "current_amperes": ("Measured motor current.", "current_a"),
        "voltage_volts": ("Measured supply voltage.", "voltage_v"),
        "temperature_celsius": ("Measured temperature.", "temperature_c"),
        "feedback_age_seconds": ("Age of the newest feedback.", "feedback_age_s"),
        "drive_faults": ("The drive's fault word.", "drive_faults"),
    }
    joints = tuple(zip(body.joints, view.snapshot.joints, strict=True))
    for name, (text, key) in figures.items():
        values = tuple(({"joint": joint}, float(getattr(now, key))) for joint, now in joints)
        yield Family(f"motord_joint_{name}", "gauge", text, values)


def _rest(body: Body, view: View) -> Iterator[Family]:
    unknown_s = rest_report(view.snapshot, body.joints)["rest_unknown_s"]
    values = tuple(({"joint": joint}, unknown_s.get(joint, 0.0)) for joint in body.joints)
    text = "How long it has been unknown whether the joint turns; 0: it is known."
    yield Family("motord_joint_rest_unknown_seconds", "gauge", text, values)


def _loop(status: Mapping[str, Any]) -> Iterator[Family]:
    loop = status["loop"]
    yield Family(
        "motord_loop_overruns_total", "counter", "Missed periods.", (({}, loop["overruns"]),)
    )
    late = tuple(
        ({"quantile": quantile}, loop["lateness_us"][key] / 1e6)
        for key, quantile in (("p50", "0.5"), ("p99", "0.99"), ("p99_9", "0.999"), ("max", "1"))
    )
    yield Family(
        "motord_loop_lateness_seconds", "gauge", "Lateness of the loop since its start.", late
    )


def _lines(status: Mapping[str, Any]) -> Iterator[Family]:
    lines = status["lines"].items()
    yield Family(
        "motord_line_exchanges_total",
        "counter",
        "Exchanges with drives.",
        tuple(({"line": name}, line["exchanges"]) for name, line in lines),
    )
    errors = tuple(
        ({"line": name, "kind": kind}, count)
        for name, line in lines
        for kind, count in line["errors"].items()
    )
    yield Family("motord_line_errors_total", "counter", "Exchanges that failed.", errors)
    yield Family(
        "motord_line_cycle_hertz",
        "gauge",
        "Exchanges a second with each drive.",
        tuple(({"line": name}, _number(line["cycle_hz"])) for name, line in lines),
    )


def _battery(battery: Mapping[str, Any] | None) -> Iterator[Family]:
    if battery is None:
        return
    for name, text, key in (
        ("voltage_volts", "Measured voltage of the battery.", "voltage_v"),
        ("current_amperes", "Current of the battery; negative: discharging.", "current_a"),
    ):
        yield Family(f"motord_battery_{name}", "gauge", text, (({}, _number(battery[key])),))
    states = tuple(
        ({"state": word}, float(word == battery["state"]))
        for word in ("unknown", "normal", "warning", "critical")
    )
    yield Family("motord_battery_state", "gauge", "1 for the battery's state.", states)


def _commands(status: Mapping[str, Any]) -> Iterator[Family]:
    commands = status["commands"]
    yield Family(
        "motord_commands_total", "counter", "Commands taken.", (({}, commands["accepted"]),)
    )
    refused = tuple(({"reason": why}, count) for why, count in commands["refused"].items())
    yield Family("motord_commands_refused_total", "counter", "Commands refused.", refused)
    dropped = tuple(
        ({"publisher": name}, feed["dropped"])
        for name, feed in {
            **status["publishers"],
            **((status["bus"] or {}).get("publishers", {})),
        }.items()
    )
    yield Family(
        "motord_samples_dropped_total", "counter", "Messages lost to slow readers.", dropped
    )
    restarts = (status["bus"] or {}).get("restarts", 0)
    yield Family(
        "motord_bus_restarts_total", "counter", "Restarts of the bus process.", (({}, restarts),)
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value
