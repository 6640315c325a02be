# SPDX-License-Identifier: Apache-2.0
"""What must hold between the parts of a robot file."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.battery_rules import battery_alone
from motord.config.finding import Finding
from motord.config.imu_rules import imu_axes, imu_line, imu_rates
from motord.config.model import REST_MAX_S, Robot, SkidBase
from motord.config.problems import nearest

JOINTS_MIN, JOINTS_MAX = 2, 8  # JOINTS_MAX, LINES_MAX: csrc/api.h
LINES_MAX = 4


def _joint_count(robot: Robot) -> Iterator[Finding]:
    sides = tuple(("joint", name, "side") for name in robot.joint)
    count = len(robot.joint)
    if not JOINTS_MIN <= count <= JOINTS_MAX:
        text = f"{count} joints are too {'few' if count < JOINTS_MIN else 'many'}"
        yield Finding((("joint",),), f"{text} ({JOINTS_MIN} to {JOINTS_MAX})")
    for side in ("left", "right"):
        if count and all(joint.side != side for joint in robot.joint.values()):
            yield Finding((("joint",), *sides), f'no joint is on the {side} (side = "{side}")')


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


def _stops_in_time(robot: Robot) -> Iterator[Finding]:
    if (rest_s := robot.limits.rest_s()) > REST_MAX_S:
        text = f"from full speed it takes {rest_s:.0f} s to rest (at most {REST_MAX_S:g} s)"
        yield Finding((("limits",),), f"{text}: more deceleration and jerk, or less speed")


def _slip_factor(robot: Robot) -> Iterator[Finding]:
    if isinstance(robot.base, SkidBase) and "track_slip_factor" not in robot.base.model_fields_set:
        text = "a skid base without track_slip_factor turns less than it is told (1.5 is usual)"
        yield Finding((("base", "track_slip_factor"),), text, warning=True)


def _safety_pins(robot: Robot) -> Iterator[Finding]:
    estop = robot.safety.estop
    if estop is not None and estop.contact == "normally-open":
        text = "a broken wire of a normally-open contact is not noticed: nothing would stop"
        yield Finding((("safety", "estop", "contact"),), text, warning=True)


ROBOT_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _joint_count,
    _known_lines,
    _line_count,
    _stops_in_time,
    _slip_factor,
    battery_alone,
    imu_axes,
    imu_line,
    imu_rates,
    _safety_pins,
)
