# SPDX-License-Identifier: Apache-2.0
"""The physics: wheels with mass, friction and a drive's speed loop, and the ground under them.

Pure: no clock, only `step(dt_s)` in fixed sub-steps. All values are at the wheel, so they include
the gear (inertia and torque reflected through it: Lynch & Park, Modern Robotics, 2017, 8.9.2).

Motor:      J dw/dt = torque − viscous·w − coulomb·sign(w)          (Modern Robotics, 8.9.1)
Speed loop: PI with feed-forward of its own ramp (Åström & Murray, Feedback Systems, 11.3)
Open loop:  torque = stall torque · (duty − w / w at full duty): the speed-torque line of a DC motor
Integration: backward Euler; Coulomb friction as the impulse that can at most bring the wheel to
rest (Acary & Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008, 10.1), so that a
stopped wheel stands still to the last bit.
"""

from __future__ import annotations

import enum
import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from motord_hal.sim.ground import LeastSquares, Module, SteeredGround

SUBSTEP_S = 0.001

AMBIENT_C = 25.0
THERMAL_TIME_S = 300.0
HEATING_C_S_A2 = 0.002
"""Heating of a winding to about 60 °C above ambient at a steady 10 A, as small hub motors are
rated."""
STANDSTILL_RAD_S = 0.02
"""Speed below which, with a set-point of zero, the speed loop drops its integral, which would
balance the friction and creep for ever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelModel:
    """One wheel with its share of the robot. The defaults are a hub motor of a base of about 20
    kg."""

    inertia_kg_m2: float = 0.07
    """Inertia of half the base's mass at a radius of 8 cm, with the rotor."""
    viscous_n_m_s_rad: float = 0.02
    coulomb_n_m: float = 0.3
    torque_max_n_m: float = 8.0
    torque_n_m_a: float = 0.8
    """Torque of one ampere."""
    acceleration_rad_s2: float = 80.0
    """Slope of the drive's own ramp between set-points."""
    deceleration_rad_s2: float = 40.0
    """Slope of the drive's quick stop, also of the one by its watchdog."""
    loop_time_s: float = 0.02
    """Time constant of the speed loop's proportional part."""
    integral_time_s: float = 0.1


class _Power(enum.Enum):
    OFF = enum.auto()
    SPEED = enum.auto()
    DUTY = enum.auto()
    TORQUE = enum.auto()


def _finite(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(f"{name} {value} is not finite")
    return value


class Wheel:
    """One motor with its wheel. It starts at rest, without power."""

    def __init__(self, model: WheelModel) -> None:
        self.model = model
        self.position_rad = 0.0
        self.velocity_rad_s = 0.0
        self.torque_n_m = 0.0
        self.winding_c = AMBIENT_C
        self._power = _Power.OFF
        self._target_rad_s = 0.0
        self._slope_rad_s2 = model.acceleration_rad_s2
        self._reference_rad_s = 0.0
        self._integral_n_m = 0.0
        self._duty = 0.0
        self._full_duty_rad_s = 1.0
        self._asked_n_m = 0.0
        self.blocked = False
        """Whether the wheel cannot turn."""

    @property
    def current_a(self) -> float:
        return self.torque_n_m / self.model.torque_n_m_a

    def coast(self) -> None:
        """Remove the power: only friction acts."""
        self._power = _Power.OFF

    def turn(self, velocity_rad_s: float) -> None:
        """Run the speed loop towards this velocity. Raises ValueError for NaN and infinity."""
        self._regulate(_finite("velocity", velocity_rad_s), self.model.acceleration_rad_s2)

    def brake(self) -> None:
        """Do a quick stop: run the speed loop to zero along the drive's deceleration, then hold."""
        self._regulate(0.0, self.model.deceleration_rad_s2)

    def push(self, duty: float, full_duty_rad_s: float) -> None:
        """Run open loop with this part (−1 to 1) of the voltage that turns the free wheel at
        `full_duty_rad_s`. Raises ValueError for NaN and infinity."""
        self._duty = max(-1.0, min(1.0, _finite("duty", duty)))
        self._full_duty_rad_s = _finite("full duty", full_duty_rad_s)
        self._power = _Power.DUTY

    def drive(self, torque_n_m: float) -> None:
        """Run the current loop with this torque at the wheel. Raises ValueError for NaN and
        infinity."""
        self._asked_n_m = _finite("torque", torque_n_m)
        self._power = _Power.TORQUE

    def _regulate(self, target_rad_s: float, slope_rad_s2: float) -> None:
        if self._power is not _Power.SPEED:
            self._reference_rad_s = self.velocity_rad_s
            self._integral_n_m = 0.0
        self._power = _Power.SPEED
        self._target_rad_s = target_rad_s
        self._slope_rad_s2 = slope_rad_s2

    def substep(self, dt_s: float) -> None:
        idle = self._power is _Power.OFF and self.velocity_rad_s == self.torque_n_m == 0.0
        if idle and self.winding_c == AMBIENT_C:
            return  # nothing below would change
        torque_max = self.model.torque_max_n_m
        self.torque_n_m = max(-torque_max, min(torque_max, self._wanted_torque_n_m(dt_s)))
        self._move(dt_s)
        heating = HEATING_C_S_A2 * self.current_a**2 - (self.winding_c - AMBIENT_C) / THERMAL_TIME_S
        self.winding_c += heating * dt_s

    def _wanted_torque_n_m(self, dt_s: float) -> float:
        if self._power is _Power.OFF:
            return 0.0
        if self._power is _Power.TORQUE:
            return self._asked_n_m
        if self._power is _Power.DUTY:
            slower = self.velocity_rad_s / self._full_duty_rad_s
            return self.model.torque_max_n_m * (self._duty - slower)
        return self._speed_loop(dt_s)

    def _speed_loop(self, dt_s: float) -> float:
        model = self.model
        most = self._slope_rad_s2 * dt_s
        ramp = max(-most, min(most, self._target_rad_s - self._reference_rad_s))
        self._reference_rad_s += ramp
        error = self._reference_rad_s - self.velocity_rad_s
        gain = model.inertia_kg_m2 / model.loop_time_s
        feed_forward = model.inertia_kg_m2 * ramp / dt_s
        torque = feed_forward + gain * error + self._integral_n_m
        if abs(torque) < model.torque_max_n_m:
            self._integral_n_m += gain * error * dt_s / model.integral_time_s
        if self._reference_rad_s == 0.0 and abs(self.velocity_rad_s) < STANDSTILL_RAD_S:
            self._integral_n_m = 0.0
        return torque

    def _move(self, dt_s: float) -> None:
        model = self.model
        drag = 1.0 + dt_s * model.viscous_n_m_s_rad / model.inertia_kg_m2
        free = (self.velocity_rad_s + dt_s * self.torque_n_m / model.inertia_kg_m2) / drag
        held = dt_s * model.coulomb_n_m / model.inertia_kg_m2 / drag
        stands = self.blocked or abs(free) <= held
        self.velocity_rad_s = 0.0 if stands else free - math.copysign(held, free)
        self.position_rad += self.velocity_rad_s * dt_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Contact of a wheel with the ground."""

    side: str
    """"left" | "right"."""
    wheel_radius_m: float
    row: tuple[float, float, float] | None = None
    """Shares of a base's motion forward, to the left and about in the rim's speed, for a base that
    moves sideways. None: a wheel of a base with two sides."""


@dataclass(slots=True)
class Truth:
    """True motion of the base."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    """Heading from −π to π."""
    distance_m: float = 0.0
    turned_rad: float = 0.0
    moved_max_m_s: float = 0.0
    """Greatest speed of a wheel so far, at its rim."""


class Plant:
    """All wheels, and the base that rolls on those with a contact: two sides, as differential and
    skid-steered bases have (Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2), wheels with
    rollers, or steered ones. The pose follows the exact arc of each sub-step."""

    def __init__(
        self,
        wheels: Mapping[str, Wheel],
        contacts: Mapping[str, Contact],
        track_m: float,
        *,
        modules: Sequence[Module] = (),
        slip_variance_m2_per_m: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Set the plant up. `modules` are the wheels of a base with steered wheels."""
        if not (math.isfinite(track_m) and track_m > 0.0):
            raise ValueError(f"track {track_m} m: must be positive")
        strafing = all(contact.row is not None for contact in contacts.values())
        sides = {contact.side for contact in contacts.values()}
        if not (strafing or modules) and sides != {"left", "right"}:
            raise ValueError("a base needs a wheel on the left and one on the right")
        self.wheels = dict(wheels)
        self._all = tuple(wheels.values())
        self._rolling = [(self.wheels[name], contact) for name, contact in contacts.items()]
        self._per_side = {
            side: sum(contact.side == side for contact in contacts.values())
            for side in ("left", "right")
        }
        self._track_m = track_m
        self._fit = (
            LeastSquares([c.row or (0.0, 0.0, 0.0) for c in contacts.values()])
            if any(c.row for c in contacts.values())
            else None
        )
        self._steered = SteeredGround(modules, self._angle_rad) if modules else None
        self._rim = {name: i for i, name in enumerate(contacts)}
        self._slip_variance_m2_per_m = slip_variance_m2_per_m
        self._random = random.Random(f"slip {seed}")
        self.truth = Truth()
        self.time_s = 0.0
        self.rest_s = 0.0
        """Time for which all wheels have stood still."""
        self.yaw_rad = 0.0
        """Angle turned to the left since the start, without reset or wrap."""
        self.slipping: dict[str, float] = {}
        """Side → part of its wheels' travel that is lost on the ground."""
        self._due_s = 0.0

    @property
    def at_rest(self) -> bool:
        return not any(wheel.velocity_rad_s for wheel in self._all)

    def reset_truth(self) -> None:
        self.truth = Truth()

    def step(self, dt_s: float) -> None:
        """Advance by `dt_s`, in sub-steps. A remainder waits for the next call. Raises ValueError
        for NaN, infinity and negative times."""
        if not (math.isfinite(dt_s) and dt_s >= 0.0):
            raise ValueError(f"time step {dt_s} s")
        self._due_s += dt_s
        while self._due_s > 0.999 * SUBSTEP_S:
            self._due_s -= SUBSTEP_S
            self.substep()

    def substep(self) -> None:
        """Advance by SUBSTEP_S."""
        self.time_s += SUBSTEP_S
        for wheel in self._all:
            wheel.substep(SUBSTEP_S)
        if self.at_rest:
            self.rest_s += SUBSTEP_S
        else:
            self.rest_s = 0.0
            self._roll()

    def _angle_rad(self, name: str) -> float:
        return self.wheels[name].position_rad

    def _roll(self) -> None:
        if self._fit is not None:
            self._follow_best(self._fit.motion(self._rims_m()))
            return
        if self._steered is not None:
            rims_m = self._rims_m()
            self._follow_best(self._steered.motion(lambda name: rims_m[self._rim[name]]))
            return
        travel_m = {"left": 0.0, "right": 0.0}
        for wheel, contact in self._rolling:
            rim_m_s = wheel.velocity_rad_s * contact.wheel_radius_m
            travel_m[contact.side] += rim_m_s * SUBSTEP_S / self._per_side[contact.side]
            self.truth.moved_max_m_s = max(self.truth.moved_max_m_s, abs(rim_m_s))
        for side, part in self.slipping.items():
            travel_m[side] *= 1.0 - part
        if self._slip_variance_m2_per_m:
            for side, travel in travel_m.items():
                deviation = math.sqrt(self._slip_variance_m2_per_m * abs(travel))
                travel_m[side] = travel + self._random.gauss(0.0, deviation)
        self._follow_arc(
            (travel_m["left"] + travel_m["right"]) / 2.0,
            (travel_m["right"] - travel_m["left"]) / self._track_m,
        )

    def _rims_m(self) -> list[float]:
        rims_m = []
        for wheel, contact in self._rolling:
            rim_m_s = wheel.velocity_rad_s * contact.wheel_radius_m
            self.truth.moved_max_m_s = max(self.truth.moved_max_m_s, abs(rim_m_s))
            travel_m = rim_m_s * SUBSTEP_S * (1.0 - self.slipping.get(contact.side, 0.0))
            if self._slip_variance_m2_per_m:
                deviation = math.sqrt(self._slip_variance_m2_per_m * abs(travel_m))
                travel_m += self._random.gauss(0.0, deviation)
            rims_m.append(travel_m)
        return rims_m

    def _follow_best(self, motion: tuple[float, float, float]) -> None:
        """Apply the motion that fits all rims best. The rest is slip."""
        forward_m, left_m, turn_rad = motion
        self._follow_arc(forward_m, turn_rad, left_m)

    def _follow_arc(self, forward_m: float, turn_rad: float, left_m: float = 0.0) -> None:
        """Move along the chord of an arc: length · sin(turn/2)/(turn/2), in the direction of half
        the turn."""
        half = turn_rad / 2.0
        chord = math.sin(half) / half if half else 1.0
        truth = self.truth
        sine, cosine = math.sin(truth.heading_rad + half), math.cos(truth.heading_rad + half)
        truth.x_m += chord * (forward_m * cosine - left_m * sine)
        truth.y_m += chord * (forward_m * sine + left_m * cosine)
        truth.heading_rad = math.remainder(truth.heading_rad + turn_rad, 2.0 * math.pi)
        truth.distance_m += math.hypot(forward_m, left_m)
        truth.turned_rad += abs(turn_rad)
        self.yaw_rad += turn_rad


class Encoder:
    """Counts edges of a motor shaft, modulo 2^bits, from a given start."""

    def __init__(self, counts_per_turn: int, bits: int, start: int = 0) -> None:
        self._counts_per_rad = counts_per_turn / (2.0 * math.pi)
        self.mask = (1 << bits) - 1
        self._start = start
        self._origin_rad = 0.0

    def count(self, shaft_rad: float) -> int:
        turned = math.floor((shaft_rad - self._origin_rad) * self._counts_per_rad)
        return (self._start + turned) & self.mask

    def restart(self, shaft_rad: float, start: int) -> None:
        """Set the counter to `start` at the shaft's present angle, when power comes back."""
        self._origin_rad = shaft_rad
        self._start = start
