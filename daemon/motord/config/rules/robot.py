# SPDX-License-Identifier: Apache-2.0
"""What must hold between the parts of a robot file."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.rules.battery import battery_alone
from motord.config.rules.imu import imu_axes, imu_line, imu_rates
from motord.config.sections.model import REST_MAX_S, Robot, SkidBase
from motord.config.toml_lines import Path
from motord_hal.base.nearest import nearest

JOINTS_MIN, JOINTS_MAX = 2, 8  # JOINTS_MAX, LINES_MAX: csrc/api.h
LINES_MAX = 4
_WHEEL_RADIUS_USUAL_M, _TRACK_USUAL_M = 0.4, 3.0
"""Small robots have less; more is allowed, and asked about."""
STOP_USUAL_M = 3.0
"""Braking distance of a fast delivery robot; small robots have less."""
REST_RATIO_MAX = 1.5
"""Between the stopping times of the two axes."""


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


def _axes_stop_alike(robot: Robot) -> Iterator[Finding]:
    """A stop keeps its curvature, so the slower axis sets the time of both."""
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


def _long_stop(robot: Robot) -> Iterator[Finding]:
    limits = robot.limits
    stop_m = limits.linear_m_s * limits.linear_rest_s(limits.linear_m_s) / 2.0
    if stop_m > STOP_USUAL_M:
        text = (
            f"from {limits.linear_m_s:g} m/s the robot takes {stop_m:.1f} m to rest: is there so "
            "much room? raise linear_deceleration_m_s2 or lower linear_m_s"
        )
        keys = ("linear_m_s", "linear_deceleration_m_s2")
        yield Finding(tuple(("limits", key) for key in keys), text, warning=True)


def _slip_factor(robot: Robot) -> Iterator[Finding]:
    if isinstance(robot.base, SkidBase) and "track_slip_factor" not in robot.base.model_fields_set:
        text = "a skid base without track_slip_factor turns less than commanded (1.5 is usual)"
        yield Finding((("base", "track_slip_factor"),), text, warning=True)


def _geometry(robot: Robot) -> Iterator[Finding]:
    """A base of another size than it is drives at another speed than its set-point."""
    base = robot.base
    radii: list[tuple[Path, float]] = [(("base", "wheel_radius_m"), base.wheel_radius_m)]
    radii += [
        (("joint", name, "wheel_radius_m"), joint.wheel_radius_m)
        for name, joint in robot.joint.items()
        if joint.wheel_radius_m is not None
    ]
    for path, radius_m in radii:
        if radius_m > _WHEEL_RADIUS_USUAL_M:
            text = f"{radius_m:g} m is a wheel of {2 * radius_m:.3g} m across: is that so?"
            yield Finding((path,), text, warning=True)
    track: Path = ("base", "track_m")
    if base.track_m > _TRACK_USUAL_M:
        text = f"{base.track_m:g} m between left and right wheels: is that so?"
        yield Finding((track,), text, warning=True)
    elif base.track_m < min(radius_m for _, radius_m in radii):
        text = (
            f"{100 * base.track_m:.3g} cm between left and right wheels is less than a wheel's "
            "radius: is it in metres, from the middle of one tyre to that of the other?"
        )
        yield Finding((track, radii[0][0]), text, warning=True)


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
    _axes_stop_alike,
    _long_stop,
    _slip_factor,
    _geometry,
    battery_alone,
    imu_axes,
    imu_line,
    imu_rates,
    _safety_pins,
)
