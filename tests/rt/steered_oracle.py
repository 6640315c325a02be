# SPDX-License-Identifier: Apache-2.0
"""Oracle for steered bases, from the textbook and with numpy: each wheel by its rolling and sliding
constraints (Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2.3, equations 3.12 and 3.13), the
inverse as numpy's least squares; and small bases around the bare core."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from tests.rt.core_rig import TICK_S, Rig, core_config, joint_config

RADIUS_M = 0.05
COUNT_RAD = math.tau / (1 << 20)
STEERING_RAD_S = 3.0
STEERING_RAD_S2 = 40.0
WHEELBASE_M, TRACK_M = 0.3, 0.2

ROLLS = joint_config(
    0.0,
    row={"x": 0.0, "y": 0.0, "lever_m": 0.0},
    wheel_radius_m=RADIUS_M,
    velocity_min_rad_s=-60.0,
    velocity_max_rad_s=60.0,
    rad_per_count=COUNT_RAD,
    counter_bits=64,
)
ROLLS["pwm"] |= {"full_duty_rad_s": 60.0}


def steers(range_rad: float, **position: Any) -> dict[str, Any]:
    limits = {"position_min_rad": -range_rad, "position_max_rad": range_rad}
    limits |= {"velocity_rad_s": STEERING_RAD_S, "acceleration_rad_s2": STEERING_RAD_S2}
    return ROLLS | {"position": {"used": 1, "reference": 0, "zero_count": 0} | limits | position}


def module(x_m: float, y_m: float, steering: int = 0, traction: int = 0) -> dict[str, Any]:
    """Return a module; `steering` and `traction` are numbers of joints from 1, 0 without one."""
    place = {"x_m": x_m, "y_m": y_m, "angle_rad": 0.0}
    return place | {"steering": steering, "traction": traction}


def swerve(count: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    angles = [math.tau * k / count + 0.4 for k in range(count)]
    modules = [
        module(0.3 * math.cos(a), 0.25 * math.sin(a), 2 * k + 1, 2 * k + 2)
        for k, a in enumerate(angles)
    ]
    return modules, [steers(math.pi), ROLLS] * count


def parts_of(kind: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the modules and joints of a base of this kind."""
    rear = [module(0.0, 0.1, 0, 1), module(0.0, -0.1, 0, 2)]
    match kind:
        case "bicycle":
            return [module(WHEELBASE_M, 0.0, 2), module(0.0, 0.0, 0, 1)], [ROLLS, steers(0.6)]
        case "tricycle":
            driven = [module(WHEELBASE_M, 0.0, 2, 1), module(0.0, 0.1), module(0.0, -0.1)]
            return driven, [ROLLS, steers(1.6)]
        case "ackermann":
            front = [module(WHEELBASE_M, 0.1, 3), module(WHEELBASE_M, -0.1, 4)]
            return front + rear, [ROLLS, ROLLS, steers(0.7), steers(0.7)]
        case "rear-steered":
            return [module(-WHEELBASE_M, 0.0, 3), *rear], [ROLLS, ROLLS, steers(0.7)]
    return swerve(int(kind.removeprefix("swerve")))


CARS = ("bicycle", "tricycle", "ackermann", "rear-steered")
SWERVES = ("swerve2", "swerve3", "swerve4")
KINDS = CARS + SWERVES


def config_of(kind: str) -> dict[str, Any]:
    modules, joints = parts_of(kind)
    shape = {"module_count": len(modules), "module": modules, "joint": joints}
    return core_config(2, joint_count=len(joints), **shape)


def floor(place: dict[str, Any], twist: Sequence[float]) -> np.ndarray:
    """Return the speed of the base at the wheel, v + w × p; twist: (linear, lateral, angular)."""
    vx, vy, w = twist
    return np.array([vx - place["y_m"] * w, vy + place["x_m"] * w])


def equations(kind: str, angles_rad: Sequence[float]) -> tuple[np.ndarray, list[int | None]]:
    """Return rows of factors of (linear, lateral, angular), and for each row the joint whose rim
    speed it equals; None: it equals 0."""
    rows, rims = [], []
    for place in parts_of(kind)[0]:
        angle = angles_rad[place["steering"] - 1] if place["steering"] else 0.0
        ground = np.array([[1.0, 0.0, -place["y_m"]], [0.0, 1.0, place["x_m"]]])
        rows.append(np.array([-math.sin(angle), math.cos(angle)]) @ ground)
        rims.append(None)
        if place["traction"]:
            rows.append(np.array([math.cos(angle), math.sin(angle)]) @ ground)
            rims.append(place["traction"] - 1)
    return np.array(rows), rims


def twist_of(kind: str, angles_rad: Sequence[float], rims_m_s: Sequence[float]) -> np.ndarray:
    """Return the twist by least squares; a car's lateral speed is always 0 and no unknown."""
    rows, of = equations(kind, angles_rad)
    values = np.array([0.0 if j is None else rims_m_s[j] for j in of])
    if kind in CARS:
        rows[:, 1] = 0.0
    return np.linalg.lstsq(rows, values, rcond=None)[0]


def pointing(kind: str, twist: Sequence[float]) -> list[float]:
    """Return the angles of the steered joints for a twist, 0 for the others. A wheel whose angle
    would be out of range points in the opposite direction."""
    modules, joints = parts_of(kind)
    angles = [0.0] * len(joints)
    for place in modules:
        if place["steering"]:
            x, y = floor(place, twist)
            angle = math.atan2(y, x)
            most = joints[place["steering"] - 1]["position"]["position_max_rad"]
            if abs(angle) > most + 1e-6:
                angle -= math.copysign(math.pi, angle)
            angles[place["steering"] - 1] = angle
    return angles


def rolling(kind: str, twist: Sequence[float], angles_rad: Sequence[float]) -> list[float]:
    """Return the rim speeds of the joints in m/s; 0 for a joint that drives no wheel."""
    rims = [0.0] * len(angles_rad)
    for place in parts_of(kind)[0]:
        if place["traction"]:
            angle = angles_rad[place["steering"] - 1] if place["steering"] else 0.0
            direction = np.array([math.cos(angle), math.sin(angle)])
            rims[place["traction"] - 1] = float(floor(place, twist) @ direction)
    return rims


class PositionRig(Rig):
    """A core whose wheels roll as they are set; joints that take positions turn to their set-points
    at once, but for those in `stuck`."""

    def __init__(self, config: dict[str, Any]) -> None:
        super().__init__(config)
        self.stuck: set[int] = set()
        self.steering = [
            j for j in range(self.config.joint_count) if self.config.joint[j].position.used
        ]

    def follow(self, dt_s: float) -> None:
        before = list(self.position_rad)
        super().follow(dt_s)
        turning = self.out.positioned if self.out.enabled else 0
        for j in self.steering:
            feedback = self.feedback[j]
            moves = turning >> j & 1 and j not in self.stuck
            at_rad = self.position_rad[j] = self.out.position_rad[j] if moves else before[j]
            feedback.count = round(at_rad / COUNT_RAD) % (1 << 64)
            feedback.velocity_rad_s = (at_rad - before[j]) / TICK_S


class SteeredRig(PositionRig):
    def __init__(self, kind: str) -> None:
        super().__init__(config_of(kind))
        self.kind = kind

    @property
    def twist(self) -> np.ndarray:
        shown = self.shown
        return np.array(
            [
                shown.setpoint_linear_m_s,
                shown.lateral.setpoint_lateral_m_s,
                shown.setpoint_angular_rad_s,
            ]
        )

    @property
    def angles(self) -> list[float]:
        """Measured angles of the joints that steer; 0 for the others."""
        found = self.state.odometry.angle_rad
        return [found[j] if j in self.steering else 0.0 for j in range(self.config.joint_count)]
