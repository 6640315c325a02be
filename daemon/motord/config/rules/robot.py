# SPDX-License-Identifier: Apache-2.0
"""Rules between the parts of a robot file."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.rules.base import BASE_RULES
from motord.config.rules.battery import battery_alone
from motord.config.rules.imu import imu_axes, imu_line, imu_rates
from motord.config.rules.limits import stops
from motord.config.sections.bases import JointsBase
from motord.config.sections.model import Robot
from motord_hal.base.nearest import nearest

JOINTS_MIN, JOINTS_MAX = 2, 8  # JOINTS_MAX, LINES_MAX: csrc/api/api.h
LINES_MAX = 4
REST_RATIO_MAX = 1.5
"""Largest usual ratio between the stopping times of the two axes."""


def _joint_count(robot: Robot) -> Iterator[Finding]:
    count = len(robot.joint)
    least = 1 if isinstance(robot.base, JointsBase) else JOINTS_MIN
    if not least <= count <= JOINTS_MAX:
        text = f"{count} joints are too {'few' if count < least else 'many'}"
        yield Finding((("joint",),), f"{text} ({least} to {JOINTS_MAX})")


def _known_lines(robot: Robot) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        if joint.line not in robot.line:
            meant = nearest(joint.line, robot.line)
            hint = f'did you mean "{meant}"?' if meant else f"known: {', '.join(robot.line)}"
            text = f'there is no line "{joint.line}" ({hint})'
            yield Finding((("joint", name, "line"), ("line", joint.line)), text)


def _line_count(robot: Robot) -> Iterator[Finding]:
    if not 1 <= len(robot.line) <= LINES_MAX:
        yield Finding((("line",),), f"{len(robot.line)} lines (1 to {LINES_MAX})")
    for name in robot.line:
        if all(joint.line != name for joint in robot.joint.values()):
            uses = tuple(("joint", joint, "line") for joint in robot.joint)
            yield Finding((("line", name), *uses), "no joint is on this line", warning=True)


def _stops(robot: Robot) -> Iterator[Finding]:
    yield from stops(robot.limits, strafes=robot.base.strafes)


def _axes_stop_alike(robot: Robot) -> Iterator[Finding]:
    """Warn of an axis that stops slowly: a stop keeps its curvature, so that axis sets the time of
    both."""
    linear_s, angular_s = robot.limits.axes_rest_s()
    fast_s, slow_s = sorted((linear_s, angular_s))
    if slow_s <= REST_RATIO_MAX * fast_s:
        return
    slow, keys = ("angular", ("angular_deceleration_rad_s2", "angular_rad_s3"))
    if linear_s > angular_s:
        slow, keys = ("linear", ("linear_deceleration_m_s2", "linear_m_s3"))
    text = (
        f"the {slow} axis lengthens a stop in a curve: from full speed linear motion takes "
        f"{linear_s:.2f} s to rest and turning {angular_s:.2f} s, and the slower one sets the "
        f"time; raise {keys[0]} (and {keys[1]}, if it is limited)"
    )
    yield Finding((("limits", keys[0]), ("limits",)), text, warning=True)


def _safety_pins(robot: Robot) -> Iterator[Finding]:
    estop = robot.safety.estop
    if estop is not None and estop.contact == "normally-open":
        text = "a broken wire of a normally-open contact is not noticed: nothing would stop"
        yield Finding((("safety", "estop", "contact"),), text, warning=True)


ROBOT_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _joint_count,
    *BASE_RULES,
    _known_lines,
    _line_count,
    _stops,
    _axes_stop_alike,
    battery_alone,
    imu_axes,
    imu_line,
    imu_rates,
    _safety_pins,
)
