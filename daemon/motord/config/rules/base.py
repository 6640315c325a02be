# SPDX-License-Identifier: Apache-2.0
"""Rules between a base and its wheels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

from motord.config.finding import Finding
from motord.config.rules.joints import JOINT_RULES
from motord.config.rules.steering import STEERING_RULES
from motord.config.sections.bases import (
    PLACES,
    JointsBase,
    MecanumBase,
    OmniBase,
    SkidBase,
    SteeredBase,
    TwoSidedBase,
    wheel_row,
)
from motord.config.sections.model import Joint, Robot
from motord.config.toml_lines import Path

_WHEEL_RADIUS_USUAL_M, _TRACK_USUAL_M = 0.4, 3.0
"""Usual sizes: small robots have less; for more, the check warns."""
_LEVER_LEAST = 0.1
"""Least lever, as a part of half the wheels' distance: with less a base turns only against much
slip."""
_DETERMINED_LEAST = 1e-6
"""The same bound as in csrc/core/kinematics/kinematics.c."""
_KEYS = ("side", "place", "angle_rad", "x_m", "y_m", "rolling_rad")
_OF_KIND: dict[str, tuple[str, ...]] = {
    "differential": ("side",),
    "skid": ("side",),
    "mecanum": ("place",),
    "omni": ("angle_rad", "x_m", "y_m", "rolling_rad"),
    "ackermann": ("place",),
    "tricycle": ("place",),
    "swerve": ("place", "x_m", "y_m"),
    "joints": (),
}
_CAR_PLACES = f"place is missing: one of front, rear, {', '.join(PLACES)}"


def _placed(joint: Joint, kind: str) -> bool:
    given = joint.x_m is not None, joint.y_m is not None
    if kind == "omni":
        return all(given) if any(given) else joint.angle_rad is not None
    if kind == "swerve" and any(given):
        return all(given)
    if kind == "joints":
        return True
    return getattr(joint, _OF_KIND[kind][0]) is not None


def _places(robot: Robot) -> Iterator[Finding]:
    """Check that every wheel has a place, in the terms of its base."""
    kind = robot.base.kind
    for name, joint in robot.joint.items():
        for key in _KEYS:
            if getattr(joint, key) is not None and key not in _OF_KIND[kind]:
                wanted = " or ".join(_OF_KIND[kind][:2])
                text = f"a {kind} base does not have it: its wheels have {wanted}"
                text = text if wanted else "a joint without a base has no place on one"
                yield Finding((("joint", name, key),), text)
        if joint.angle_rad is not None and joint.x_m is not None:
            text = "the wheel's place is given twice: by angle_rad, and by x_m and y_m"
            yield Finding((("joint", name, "angle_rad"), ("joint", name, "x_m")), text)
        if not _placed(joint, kind):
            wanted = {
                "mecanum": f"place is missing: one of {', '.join(PLACES)}",
                "omni": "angle_rad is missing (or x_m and y_m): where is this wheel?",
                "ackermann": _CAR_PLACES,
                "tricycle": _CAR_PLACES,
                "swerve": "place is missing (or x_m and y_m): where is this wheel?",
            }.get(kind, 'side is missing: "left" or "right"')
            yield Finding((("joint", name),), wanted)


def _sides(robot: Robot) -> Iterator[Finding]:
    if not isinstance(robot.base, TwoSidedBase) or not robot.joint:
        return
    sides = tuple(("joint", name, "side") for name in robot.joint)
    for side in ("left", "right"):
        if all(joint.side != side for joint in robot.joint.values()):
            yield Finding((("joint",), *sides), f'no joint is on the {side} (side = "{side}")')


def _corners(robot: Robot) -> Iterator[Finding]:
    """Check that a mecanum base has one wheel at each corner."""
    if not isinstance(robot.base, MecanumBase):
        return
    at = tuple(("joint", name, "place") for name in robot.joint)
    for place in PLACES:
        count = sum(joint.place == place for joint in robot.joint.values())
        if count != 1:
            text = f"a mecanum base has one wheel at {place}, not {count}"
            yield Finding((*at, ("joint",)), text)


def _can_move(robot: Robot) -> Iterator[Finding]:
    """Check that the wheels determine the motion: no wheel could brake a motion in which none
    turns."""
    base, joints = robot.base, robot.joint
    if (
        isinstance(base, SteeredBase)
        or not base.strafes
        or not joints
        or not all(_placed(j, base.kind) for j in joints.values())
    ):
        return
    at = (("base",), *(("joint", name) for name in joints))
    if isinstance(base, OmniBase) and len(joints) < 3:
        yield Finding(at, f"an omni base has at least 3 wheels, not {len(joints)}")
        return
    rows = [wheel_row(base, joint) for joint in joints.values()]
    xx, xy, yy = (sum(r[i] * r[k] for r in rows) for i, k in ((0, 0), (0, 1), (1, 1)))
    xw, yw, ww = (sum(r[i] * r[2] for r in rows) for i in (0, 1, 2))
    determinant = xx * (yy * ww - yw * yw) - xy * (xy * ww - yw * xw) + xw * (xy * yw - yy * xw)
    size_m = math.hypot(base.track_m, getattr(base, "wheelbase_m", 0.0)) / 2.0
    if math.sqrt(ww / len(rows)) < _LEVER_LEAST * size_m:
        why = "no wheel can turn this base: all rolling directions go through its middle"
        if isinstance(base, MecanumBase):
            why = 'no wheel can turn this base: its rollers have to form an X (rollers = "x")'
        yield Finding(at, why)
    elif not determinant > _DETERMINED_LEAST * xx * yy * ww:
        text = "the wheels do not determine how the base moves: too many roll in one direction"
        yield Finding(at, text)


def _slip_factor(robot: Robot) -> Iterator[Finding]:
    if isinstance(robot.base, SkidBase) and "track_slip_factor" not in robot.base.model_fields_set:
        text = "a skid base without track_slip_factor turns less than commanded (1.5 is usual)"
        yield Finding((("base", "track_slip_factor"),), text, warning=True)


def _geometry(robot: Robot) -> Iterator[Finding]:
    """Warn of unusual sizes: a base with a wrong size in its file drives at another speed than its
    set-point."""
    base = robot.base
    if isinstance(base, JointsBase):
        return
    radii: list[tuple[Path, float]] = [(("base", "wheel_radius_m"), base.wheel_radius_m)]
    radii += [
        (("joint", name, "wheel_radius_m"), joint.wheel_radius_m)
        for name, joint in robot.joint.items()
        if joint.wheel_radius_m is not None
    ]
    for path, radius_m in radii:
        if radius_m > _WHEEL_RADIUS_USUAL_M:
            text = f"{radius_m:g} m is a wheel of {2 * radius_m:.3g} m across: is this right?"
            yield Finding((path,), text, warning=True)
    if isinstance(base, OmniBase):
        return
    track: Path = ("base", "track_m")
    if base.track_m > _TRACK_USUAL_M:
        text = f"{base.track_m:g} m between left and right wheels: is this right?"
        yield Finding((track,), text, warning=True)
    elif base.track_m < min(radius_m for _, radius_m in radii):
        text = (
            f"{100 * base.track_m:.3g} cm between left and right wheels is less than a wheel's "
            "radius: is it in metres, from the middle of one tyre to that of the other?"
        )
        yield Finding((track, radii[0][0]), text, warning=True)


_BaseRule = Callable[[Robot], Iterator[Finding]]


def _by_kind(rule: _BaseRule) -> _BaseRule:
    """Return the rule with findings that depend on the kind of the base: a wrong kind makes them
    useless."""

    def found(robot: Robot) -> Iterator[Finding]:
        for hit in rule(robot):
            yield replace(hit, paths=(*hit.paths, ("base", "kind")))

    return found


BASE_RULES: tuple[_BaseRule, ...] = tuple(
    map(
        _by_kind,
        (
            _places,
            _sides,
            _corners,
            _can_move,
            _slip_factor,
            _geometry,
            *STEERING_RULES,
            *JOINT_RULES,
        ),
    )
)
