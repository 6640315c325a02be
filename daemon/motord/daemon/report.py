# SPDX-License-Identifier: Apache-2.0
"""Reports of the daemon about itself: `status` and `latency` of the local socket."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from motord.api.commands import CommandReport
from motord.api.snapshot import Snapshot, joints_of
from motord.bus.publish.snapshot_feed import SnapshotFeed
from motord.config.sections.bases import JointsBase, side_of, wheel_modules, wheel_row
from motord.config.sections.joint.wheels import takes_position
from motord.config.sections.model import Robot
from motord.control.health import Health
from motord.control.leases import HELD_SINCE, RELEASES, Lease
from motord.control.operation import Operation
from motord.daemon.bus_supervisor import BusSupervisor
from motord.daemon.parameters import joint as joint_parameters
from motord.daemon.parameters import robot as parameters
from motord.realtime.loop import HistogramKind, Loop, Percentiles
from motord_hal.fieldbus.ports import Line
from motord_hal.realtime.exchange import now_ns

_ODOMETRY = (
    "x_m", "y_m", "heading_rad", "distance_m", "turned_rad", "linear_m_s", "angular_rad_s",
    "lateral_m_s", "slip_m_s", "pose_covariance", "twist_covariance", "lateral_covariance",
)  # fmt: skip
_COMMAND = (
    "command_age_s", "wanted_linear_m_s", "wanted_angular_rad_s", "wanted_lateral_m_s",
    "setpoint_linear_m_s", "setpoint_angular_rad_s", "setpoint_lateral_m_s", "saturation",
)  # fmt: skip


def status(
    operation: Operation,
    health: Health,
    feeds: Mapping[str, SnapshotFeed],
    bus: BusSupervisor | None = None,
) -> dict[str, Any]:
    """Return everything that is known now, ready for JSON."""
    snapshot = operation.snapshot.to_json()
    return {
        "robot": operation.robot.robot.name,
        "pid": os.getpid(),
        "state": operation.state.value,
        "why": list(operation.why),
        "armed": snapshot["armed"],
        "at_rest": snapshot["at_rest"],
        **operation.rest_report(),
        "reasons": snapshot["reasons"],
        "limited": _limited(operation),
        "parameters": parameters.values(operation.in_force.limits, operation.robot.base)
        | joint_parameters.values(operation.robot, operation.in_force.joint_limits),
        "faults": snapshot["faults"],
        "stops": operation.stops,
        "command": {key: snapshot[key] for key in _COMMAND},
        "odometry": {key: snapshot[key] for key in _ODOMETRY}
        | {
            "degraded": snapshot["odometry_degraded"],
            "coarse_counters": joints_of(snapshot["counter_coarse"], list(operation.robot.joint)),
            "epoch": snapshot["odometry_epoch"],
            "age_s": _age_s(operation.snapshot.odometry_stamp_ns),
        },
        "joints": _joints(operation, snapshot["joints"]),
        "battery": operation.battery.report(now_ns()) if operation.battery else None,
        "imu": _imu(operation.snapshot, snapshot["imu"]),
        "loop": _loop(operation),
        "lines": {line.spec.name: _line(line, operation) for line in operation.lines},
        "leases": _leases(operation),
        "held": held(operation),
        "inputs": operation.robot.commanders(),
        "commands": _commands(operation.loop.commands()),
        "publishers": {name: feed.report() for name, feed in feeds.items()},
        "bus": bus.report() if bus else None,
        "stalls": health.stalls(),
        "version": snapshot["version"],
    }


def description(operation: Operation) -> dict[str, Any]:
    """Return what the robot file contains about the robot, for programs that command it and do not
    have the file."""
    robot = operation.robot
    return {
        "robot": robot.robot.name,
        "file": str(robot.path.absolute()),
        "joints": list(robot.joint),
        "sides": {name: side_of(robot.base, joint) for name, joint in robot.joint.items()},
        "track_m": robot.base.track_m,
        "effective_track_m": robot.base.effective_track_m,
        "wheel_radius_m": robot.base.wheel_radius_m,
        "wheel_radii_m": {name: robot.wheel_radius_m(name) for name in robot.joint},
        "wheel_rows": {name: wheel_row(robot.base, joint) for name, joint in robot.joint.items()},
        "modules": modules(robot),
        "strafes": robot.base.strafes,
        "limits": {
            "linear_m_s": robot.limits.linear_m_s,
            "angular_rad_s": robot.limits.angular_rad_s,
            "lateral_m_s": robot.limits.lateral_m_s,
        },
        "drives": not isinstance(robot.base, JointsBase),
        "takes_position": [
            name
            for name, joint in robot.joint.items()
            if takes_position(joint, robot.profiles[joint.drive])
        ],
        "feedback_timeout_s": robot.safety.feedback_timeout_s,
        "inputs": robot.commanders(),
    }


def modules(robot: Robot) -> list[dict[str, Any]]:
    """Return the wheels of a base with steered wheels, each with the names of the joints that move
    it (empty: it has no such joint). The list is empty for another base."""
    found = []
    for module in wheel_modules(robot.base, robot.joint):
        steering, traction = (one[0] if one else "" for one in (module.steering, module.traction))
        joint = robot.joint.get(steering)
        low_rad, high_rad = (
            (joint.position_min_rad, joint.position_max_rad) if joint is not None else (0.0, 0.0)
        )
        found.append({"x_m": module.x_m, "y_m": module.y_m, "steering": steering,
                      "traction": traction, "range_rad": [low_rad, high_rad]})  # fmt: skip
    return found


def latency(loop: Loop) -> dict[str, Any]:
    """Return the loop's histograms since its start: percentiles in microseconds, numbers of
    samples, and each bucket that holds samples as low_ns, high_ns, samples. They only grow: the
    difference of two answers is what came between them."""
    found = {kind: loop.percentiles(kind) for kind in HistogramKind}
    return {
        "lateness_us": _percentiles(found[HistogramKind.LATENESS], 1e3),
        "step_us": _percentiles(found[HistogramKind.STEP], 1e3),
        "command_to_core_us": _percentiles(found[HistogramKind.COMMAND], 1e3),
        "samples": {kind.name.lower(): found[kind].samples for kind in HistogramKind},
        "buckets": {
            kind.name.lower(): [[b.low_ns, b.high_ns, b.samples] for b in loop.buckets(kind)]
            for kind in HistogramKind
        },
    }


def _age_s(stamp_ns: int) -> float | None:
    """Return the age of a stamp; None: the stamp is 0, it never happened."""
    return (now_ns() - stamp_ns) / 1e9 if stamp_ns else None


def _limited(operation: Operation) -> dict[str, dict[str, Any]]:
    """Return for each reason how long it has applied, and the joint or joints that it comes
    from."""
    snapshot, joints = operation.snapshot, list(operation.robot.joint)
    found: dict[str, dict[str, Any]] = {
        reason: {"for_s": (snapshot.stamp_ns - since_ns) / 1e9}
        for reason, since_ns in snapshot.reasons_since_ns.items()
    }
    if snapshot.saturated_joint is not None and "wheel_saturated" in found:
        found["wheel_saturated"]["joint"] = joints[snapshot.saturated_joint]
    for reason, places in snapshot.reason_joints.items():
        if reason in found:
            found[reason]["joints"] = [joints[place] for place in places]
    if (derating := snapshot.derating) is not None and "derated" in found:
        found["derated"] |= {
            "joint": joints[derating.joint],
            "by": derating.by,
            "factor": derating.factor,
            "for_s": (snapshot.stamp_ns - derating.since_ns) / 1e9,
        }
    return found


def _imu(snapshot: Snapshot, shown: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the report about the imu; None: the robot has no imu, or no sample was received."""
    if snapshot.imu is None or shown is None:
        return None
    return shown | {"age_s": _age_s(snapshot.imu.stamp_ns)}


def _joints(operation: Operation, measured: list[dict[str, Any]]) -> dict[str, Any]:
    states = {name: state for line in operation.lines for name, state in line.drive_states.items()}
    words = {name: found for line in operation.lines for name, found in line.drive_faults.items()}
    positions = operation.snapshot.position_joints
    return {
        name: {
            "drive": states[name].value,
            "fault_words": list(words.get(name, ())),
            "takes_position": bool(positions >> place & 1),
            **values,
        }
        for place, (name, values) in enumerate(zip(operation.robot.joint, measured, strict=True))
    }


def _loop(operation: Operation) -> dict[str, Any]:
    loop, running = operation.loop, operation.loop.status()
    return {
        "rate_hz": operation.robot.loop.rate_hz,
        "policy": running.policy,
        "priority": running.priority,
        "ticks": running.ticks,
        "overruns": running.overruns,
        "page_faults": running.page_faults,
        "lateness_us": _percentiles(loop.percentiles(HistogramKind.LATENESS), 1e3),
        "step_ns": _percentiles(loop.percentiles(HistogramKind.STEP), 1.0),
        "refusals": running.refusals,
        "estop_input": running.estop_input,
        "watchdog": running.watchdog,
    }


def _percentiles(found: Percentiles, ns_per_unit: float) -> dict[str, float]:
    return {
        "p50": found.p50_ns / ns_per_unit,
        "p99": found.p99_ns / ns_per_unit,
        "p99_9": found.p99_9_ns / ns_per_unit,
        "max": found.max_ns / ns_per_unit,
    }


def _line(line: Line, operation: Operation) -> dict[str, Any]:
    stats = line.stats()
    trips = stats.round_trip
    return {
        "state": line.state.value,
        "waits_for": operation.waiting.of(line),
        "port": line.spec.port,
        "engine": line.engine,
        "exchanges": stats.exchanges,
        "cycles": stats.cycles,
        "reopened": stats.reopened,
        "errors": dict(stats.errors),
        "cycle_hz": stats.cycle_hz,
        "requested_hz": stats.requested_hz,
        "wire_limit_hz": stats.wire_limit_hz,
        "round_trip_us": {"p50": trips.p50_us, "p99": trips.p99_us, "max": trips.max_us},
    }


def _commands(report: CommandReport) -> dict[str, Any]:
    """Return how many commands were accepted, and how many were refused for which reason."""
    refused = {kind.name.lower(): count for kind, count in report.refused.items()}
    return {
        "accepted": report.accepted,
        "refused": refused,
        "sideways": report.sideways,
        "on_spot": report.on_spot,
    }


def _leases(operation: Operation) -> list[dict[str, Any]]:
    """Return the living leases, the source in command first, each with why it commands or waits."""
    now = now_ns()
    living = operation.leases.fresh()
    return [
        {
            "number": lease.number,
            "owner": lease.owner,
            "connection": lease.connection,
            "priority": lease.priority,
            "expires_in_s": (lease.expires_ns - now) / 1e9,
            "linear_m_s": lease.linear_m_s,
            "angular_rad_s": lease.angular_rad_s,
            "lateral_m_s": lease.lateral_m_s,
            "joints": _named(operation, lease),
            "rate_hz": lease.rate_hz,
            "held": lease.held,
            "sparse": lease.sparse,
            "why": _why(lease, living),
        }
        for lease in living
    ]


def held(operation: Operation) -> list[dict[str, Any]]:
    """Return the held sources, each with how it moves the robot again. `silent_for_s` None: its
    connection has ended."""
    now = now_ns()
    return [
        {
            "owner": one.owner,
            "held_for_s": (now - one.since_ns) / 1e9,
            "silent_for_s": (now - one.taken_ns) / 1e9 if one.taken_ns else None,
            "why": HELD_SINCE,
            "release": RELEASES,
        }
        for one in operation.leases.held()
    ]


def _named(operation: Operation, lease: Lease) -> dict[str, float]:
    """Return what a lease requests of joints without a base, by name: rad of a joint that takes
    positions, rad/s of another one."""
    names = list(operation.robot.joint)
    return {names[place]: value for place, value in lease.joint_values_u.items()}


def _why(lease: Lease, living: Sequence[Lease]) -> str:
    """Return why the lease is in command, or why it is not."""
    first, *others = living
    if lease is not first:
        which = "a higher priority" if first.priority > lease.priority else "come first"
        return f"waits: {first.owner} has {which}"
    if lease.held:
        return f"in command, held: {HELD_SINCE}"
    if not others:
        return "in command: the only one"
    if others[0].priority == lease.priority:
        return "in command: the first of its priority"
    return "in command: the highest priority"
