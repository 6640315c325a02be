# SPDX-License-Identifier: Apache-2.0
"""Bases: where their wheels are, and how each rolls for a motion of the base.

The base's frame is that of REP 103: x forward, y to the left, angles counterclockwise from x. A
wheel's row gives its rim's speed: x linear + y lateral + lever_m angular (Lynch & Park, Modern
Robotics, 2017, 13.2, equation 13.5 with the wheel's radius left out)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

from motord.config.sections.section import Section, number

if TYPE_CHECKING:
    from motord.config.sections.model import Joint

Place = Literal["front-left", "front-right", "rear-left", "rear-right", "front", "rear"]
PLACES: tuple[Place, ...] = ("front-left", "front-right", "rear-left", "rear-right")
"""The four corners."""
_SAME_PLACE_M = 1e-6


class WheelRow(NamedTuple):
    """Speed of the rim for 1 of each axis of the base's twist."""

    x: float
    y: float
    lever_m: float


class WheelPlace(NamedTuple):
    """Where a wheel meets the floor, and the direction in which it rolls when its speed is
    positive."""

    x_m: float
    y_m: float
    rolling_rad: float


class WheelModule(NamedTuple):
    """A wheel of a base with steered wheels, and the names of the joints that move it."""

    x_m: float
    y_m: float
    steering: tuple[str, ...]
    """One joint, or no joint if the wheel is fixed; more are a mistake in the robot file."""
    traction: tuple[str, ...]


class Base(Section):
    """Settings that every base has."""

    wheel_radius_m: float = number("radius of the wheels, loaded", 0.005, 5, "m")

    @property
    def strafes(self) -> bool:
        """Whether the base moves sideways, too."""
        return False


class TwoSidedBase(Base):
    """Geometry that every base with wheels on two sides has."""

    track_m: float = number("distance of the left wheels from the right ones", 0.02, 20, "m")

    @property
    def effective_track_m(self) -> float:
        """The track that counts in a turn."""
        return self.track_m


class DifferentialBase(TwoSidedBase):
    """Two driven sides, and casters that follow."""

    kind: Literal["differential"]


class SkidBase(TwoSidedBase):
    """Wheels on two sides that scrub sideways in a turn."""

    kind: Literal["skid"]
    track_slip_factor: float = number(
        "by how much the track seems wider in a turn, because the wheels scrub: turn the robot "
        "ten times on the spot, divide the turns counted by the turns made",
        1,
        10,
        "1",
        1.0,
    )

    @property
    def effective_track_m(self) -> float:
        """Track times slip factor: Mandow et al., Experimental kinematics for wheeled skid-steer
        mobile robots, IROS 2007, for instantaneous centres that lie symmetrically."""
        return self.track_m * self.track_slip_factor


class MecanumBase(Base):
    """Four wheels with rollers at 45 degrees: it moves in any direction."""

    kind: Literal["mecanum"]
    track_m: float = number("distance of the left wheels from the right ones", 0.02, 20, "m")
    wheelbase_m: float = number("distance of the front axle from the rear one", 0.02, 20, "m")
    rollers: Literal["x", "o"] = "x"
    """What the upper rollers of the four wheels form, seen from above: an X, as they should, or
    an O, by which a base turns badly or not at all."""

    @property
    def effective_track_m(self) -> float:
        """The track of a differential base that turns as this one."""
        return self.track_m + self.wheelbase_m

    @property
    def strafes(self) -> bool:
        """Whether the base moves sideways, too."""
        return True


class OmniBase(Base):
    """Three to eight wheels whose rollers lie across: it moves in any direction."""

    kind: Literal["omni"]
    radius_m: float = number("distance of the wheels from the middle of the base", 0.02, 10, "m")

    @property
    def track_m(self) -> float:
        """Distance across the base, from wheel to wheel."""
        return 2.0 * self.radius_m

    @property
    def effective_track_m(self) -> float:
        """The track of a differential base that turns as this one."""
        return self.track_m

    @property
    def strafes(self) -> bool:
        """Whether the base moves sideways, too."""
        return True


class SteeredBase(Base):
    """Geometry that every base with steered wheels has."""

    track_m: float = number("distance of the left wheels from the right ones", 0.02, 20, "m")
    wheelbase_m: float = number("distance of the front axle from the rear one", 0.02, 20, "m")

    @property
    def effective_track_m(self) -> float:
        """The track of a differential base that turns as this one."""
        return self.track_m


class CarBase(SteeredBase):
    """One axle is fixed and the other steered: two wheels with a joint each, or one in the middle
    (a tricycle, or two wheels that a rod keeps together). Its pose is that of the fixed axle's
    middle."""

    kind: Literal["ackermann", "tricycle"]
    steered: Literal["front", "rear"] = "front"
    """The axle whose wheels are steered."""
    turning_radius_m: float | None = number(
        "the tightest curve that it has to drive, of the fixed axle's middle; the check refuses "
        "steering that does not reach it",
        0,
        1000,
        "m",
        None,
    )


class SwerveBase(SteeredBase):
    """Two to four wheels that are driven and steered each: it moves in any direction."""

    kind: Literal["swerve"]

    @property
    def strafes(self) -> bool:
        """Whether the base moves sideways, too."""
        return True


class JointsBase(Section):
    """No base: each joint moves for itself, in velocity or position, as its drive takes it: a
    pan-tilt head, a lift, a conveyor."""

    kind: Literal["joints"]

    @property
    def wheel_radius_m(self) -> float:
        """0: no joint rolls on anything."""
        return 0.0

    @property
    def track_m(self) -> float:
        """0: there is no track."""
        return 0.0

    @property
    def effective_track_m(self) -> float:
        """0: there is no track."""
        return 0.0

    @property
    def strafes(self) -> bool:
        """False: there is no base that moves."""
        return False


AnyBase = DifferentialBase | SkidBase | MecanumBase | OmniBase | CarBase | SwerveBase | JointsBase


def _corner(base: SteeredBase, joint: Joint) -> tuple[float, float]:
    """Return the place of a joint at its corner or axle, in m."""
    place = joint.place or "front"
    across = place.partition("-")[2]
    y_m = {"left": base.track_m / 2.0, "right": -base.track_m / 2.0}.get(across, 0.0)
    front = place.startswith("front")
    if isinstance(base, CarBase):
        sign = 1.0 if base.steered == "front" else -1.0
        return sign * base.wheelbase_m if front == (sign > 0.0) else 0.0, y_m
    return (base.wheelbase_m if front else -base.wheelbase_m) / 2.0, y_m


def wheel_modules(base: AnyBase, joints: Mapping[str, Joint]) -> list[WheelModule]:
    """Return the wheels of a base with steered wheels, each with the joints at its place; empty for
    another base."""
    found: list[WheelModule] = []
    for name, joint in joints.items() if isinstance(base, SteeredBase) else ():
        place = wheel_place(base, joint)
        own = WheelModule(place.x_m, place.y_m, *(((name,), ()) if joint.steers else ((), (name,))))
        for i, other in enumerate(found):
            if math.dist(own[:2], other[:2]) < _SAME_PLACE_M:
                found[i] = other._replace(
                    steering=other.steering + own.steering, traction=other.traction + own.traction
                )
                break
        else:
            found.append(own)
    return found


def wheel_place(base: AnyBase, joint: Joint) -> WheelPlace:
    """Return the place of a wheel. Wheels of two sides are beside the middle: their place along the
    base makes no difference. Without a base, a joint's place is 0."""
    if isinstance(base, JointsBase):
        return WheelPlace(0.0, 0.0, 0.0)
    if isinstance(base, SteeredBase):
        if joint.x_m is not None and joint.y_m is not None:
            return WheelPlace(joint.x_m, joint.y_m, 0.0)
        return WheelPlace(*_corner(base, joint), 0.0)
    if isinstance(base, OmniBase):
        angle_rad = joint.angle_rad or 0.0
        x_m = base.radius_m * math.cos(angle_rad) if joint.x_m is None else joint.x_m
        y_m = base.radius_m * math.sin(angle_rad) if joint.y_m is None else joint.y_m
        across_rad = math.atan2(y_m, x_m) + math.pi / 2.0
        given = joint.rolling_rad
        return WheelPlace(x_m, y_m, across_rad if given is None else given)
    left = 1.0 if side_of(base, joint) == "left" else -1.0
    if isinstance(base, MecanumBase):
        front = 1.0 if (joint.place or "").startswith("front") else -1.0
        return WheelPlace(front * base.wheelbase_m / 2.0, left * base.track_m / 2.0, 0.0)
    return WheelPlace(0.0, left * base.effective_track_m / 2.0, 0.0)


def wheel_row(base: AnyBase, joint: Joint) -> WheelRow:
    """Return the row of a wheel. Two sides: Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2.3.
    Mecanum: Taheri, Qiao and Ghaeminezhad, Kinematic Model of a Four Mecanum Wheeled Mobile Robot,
    2015, equation 20. Omni: the speed of the floor along the rolling direction. Steered wheel: the
    most that each axis does, because the core computes its speed from its angle."""
    if isinstance(base, JointsBase):
        return WheelRow(0.0, 0.0, 0.0)
    place = wheel_place(base, joint)
    if isinstance(base, SteeredBase):
        if joint.steers:
            return WheelRow(0.0, 0.0, 0.0)
        if isinstance(base, SwerveBase):
            return WheelRow(1.0, 1.0, math.hypot(place.x_m, place.y_m))
        return WheelRow(1.0, 0.0, -place.y_m)
    if isinstance(base, OmniBase):
        sine, cosine = math.sin(place.rolling_rad), math.cos(place.rolling_rad)
        return WheelRow(_rounded(cosine), _rounded(sine), place.x_m * sine - place.y_m * cosine)
    if isinstance(base, MecanumBase):
        y = -1.0 if (place.x_m > 0.0) == (place.y_m > 0.0) else 1.0
        y = y if base.rollers == "x" else -y
        return WheelRow(1.0, y, y * place.x_m - place.y_m)
    return WheelRow(1.0, 0.0, -place.y_m)


def side_of(base: AnyBase, joint: Joint) -> Literal["left", "right"]:
    """Return the side of the base that a wheel is on; one in the middle counts as right."""
    if isinstance(base, OmniBase | SteeredBase):
        return "left" if wheel_place(base, joint).y_m > 1e-9 else "right"
    if isinstance(base, MecanumBase):
        return "left" if (joint.place or "").endswith("left") else "right"
    return joint.side or "right"


def _rounded(part: float) -> float:
    """Return 0 instead of a rounding error: a wheel that rolls straight on does not move
    sideways."""
    return 0.0 if abs(part) < 1e-12 else part
