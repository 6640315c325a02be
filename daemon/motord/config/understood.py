# SPDX-License-Identifier: Apache-2.0
"""The numbers that follow from a robot file, for a person to compare with the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

from motord.config.rules.limits import ceiling
from motord.config.rules.wiring.can import bus_load
from motord.config.rules.wiring.times import Reaction, Watchdog, drive_watchdogs, reactions
from motord.config.rules.wiring.wire import budget
from motord.config.sections.bases import JointsBase
from motord.config.sections.joint.limits import JointLimits
from motord.config.sections.joint.wheels import rad_per_count, takes_position, velocity_range_rad_s
from motord.config.sections.limits import LATERAL_KEYS
from motord.config.sections.model import Robot
from motord.config.sections.section import Section
from motord.config.wiring import line_specs

RPM_PER_RAD_S = 60.0 / math.tau


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    """One wheel at the robot's top speed."""

    joint: str
    velocity_rad_s: float
    velocity_rpm: float
    motor_rpm: float
    wheel_radius_m: float
    travel_per_count_mm: float | None
    """Travel on the ground. None: there is no counter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeJoint:
    """A joint without a base."""

    joint: str
    takes: str
    """`position` or `velocity`: what the joint takes."""
    position_min_rad: float | None
    """None: the joint takes velocities."""
    position_max_rad: float | None
    velocity_min_rad_s: float
    velocity_max_rad_s: float
    acceleration_rad_s2: float
    stop_time_s: float
    """Longest time of a stop, from the joint's velocity_max_rad_s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """One line. `cycle_hz`: requested rate; `share`: part of the wire's time, 1 is all of it."""

    line: str
    cycle_hz: float
    share: float
    most_hz: float
    """Rate at which the wire is fully used, if each drive answers at once."""
    least_hz: float
    """The same if each drive answers as late as its profile allows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Understood:
    """A robot file in numbers."""

    top_m_s: float
    on_spot_rad_s: float
    stop_time_s: float
    stop_distance_m: float
    """Distance of a stop from top speed."""
    lost_distance_m: float
    """Distance from top speed when the commands end, with the time until that is noticed."""
    wheels: tuple[Wheel, ...]
    joints: tuple[FreeJoint, ...]
    """Joints without a base; the lengths and speeds above are 0 then."""
    wires: tuple[Wire, ...]
    watchdogs: tuple[Watchdog, ...]
    reactions: tuple[Reaction, ...]
    """How long, and how far, the robot goes on when something fails."""
    defaults: dict[str, dict[str, float | str | bool | None]]
    """Table → key → value of what the file does not give; None: no limit."""


def understood(robot: Robot) -> Understood:
    """Return the numbers of a robot file that has no problems."""
    profiles, free = robot.profiles, isinstance(robot.base, JointsBase)
    most = ceiling(robot, profiles)
    top_m_s = 0.0 if free else min(robot.limits.linear_m_s, most.linear_m_s)
    spot_rad_s = 0.0 if math.isinf(most.angular_rad_s) else most.angular_rad_s
    stop_s = robot.limits.linear_rest_s(top_m_s)
    # a symmetric S-curve: half of top speed on average
    stop_m = top_m_s * stop_s / 2.0
    return Understood(
        top_m_s=top_m_s,
        on_spot_rad_s=min(robot.limits.angular_rad_s, spot_rad_s),
        stop_time_s=stop_s,
        stop_distance_m=stop_m,
        lost_distance_m=stop_m + top_m_s * robot.safety.command_timeout_s,
        wheels=()
        if free
        else tuple(
            _wheel(robot, name, top_m_s) for name, joint in robot.joint.items() if not joint.steers
        ),
        joints=tuple(_free_joint(robot, name) for name in robot.joint) if free else (),
        wires=tuple(_wires(robot)),
        watchdogs=tuple(drive_watchdogs(robot, profiles)),
        reactions=tuple(reactions(robot, profiles)),
        defaults={
            name: found
            for name in (("safety", "loop") if free else ("limits", "safety", "loop"))
            if (found := _defaults(getattr(robot, name), robot.base.strafes))
        },
    )


def _free_joint(robot: Robot, name: str) -> FreeJoint:
    joint, profile = robot.joint[name], robot.profiles[robot.joint[name].drive]
    low_rad_s, high_rad_s = velocity_range_rad_s(joint, profile)
    takes = takes_position(joint, profile)
    return FreeJoint(
        joint=name,
        takes="position" if takes else "velocity",
        position_min_rad=joint.position_min_rad if takes else None,
        position_max_rad=joint.position_max_rad if takes else None,
        velocity_min_rad_s=low_rad_s,
        velocity_max_rad_s=high_rad_s,
        acceleration_rad_s2=joint.acceleration_max_rad_s2,
        stop_time_s=JointLimits.of(joint).rest_s(),
    )


def _wheel(robot: Robot, name: str, top_m_s: float) -> Wheel:
    joint, radius_m = robot.joint[name], robot.wheel_radius_m(name)
    per_count_rad = abs(rad_per_count(joint, robot.profiles[joint.drive]))
    counts = per_count_rad != 1.0  # rad_per_count returns 1 without a counter
    top_rad_s = top_m_s / radius_m
    return Wheel(
        joint=name,
        velocity_rad_s=top_rad_s,
        velocity_rpm=top_rad_s * RPM_PER_RAD_S,
        motor_rpm=top_rad_s * joint.gear_ratio * RPM_PER_RAD_S,
        wheel_radius_m=radius_m,
        travel_per_count_mm=per_count_rad * radius_m * 1e3 if counts else None,
    )


def _wires(robot: Robot) -> list[Wire]:
    found = []
    for spec in line_specs(robot, robot.profiles):
        if not spec.joints:
            continue
        if spec.kind == "can":
            own, cycle_s = bus_load(spec)
            share, cycle_hz = own + cycle_s * spec.cycle_hz, spec.cycle_hz
            least_hz = most_hz = max(1.0 - own, 0.0) / cycle_s
        else:
            need = budget(spec)
            share, cycle_hz = need.share, need.cycle_hz
            most_hz = need.most_hz if share else cycle_hz
            least_hz = need.least_hz if share else cycle_hz
        found.append(
            Wire(line=spec.name, cycle_hz=cycle_hz, share=share, most_hz=most_hz, least_hz=least_hz)
        )
    return found


def _defaults(section: Section, strafes: bool) -> dict[str, float | str | bool | None]:
    values = {
        key: getattr(section, key)
        for key in type(section).model_fields
        if key not in section.model_fields_set and (strafes or key not in LATERAL_KEYS)
    }
    return {
        key: None if value == math.inf else value
        for key, value in values.items()
        if isinstance(value, float | int | str)
    }
