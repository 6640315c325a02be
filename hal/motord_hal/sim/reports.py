# SPDX-License-Identifier: Apache-2.0
"""The reports of a simulated drive: registers whose values come from its motors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from motord_hal.drives.profile import DriveProfile, Step
from motord_hal.sim.axis import Axis, Motor
from motord_hal.sim.rs485.registers import Registers, raw_of

SUPPLY_V = 24.0
"""Supply of drives whose profile gives no default for the bus voltage."""
SUPPLY_OHM = 0.1
"""Resistance of a lead-acid pair with its wiring: the voltage drops by this much for each
ampere."""


class Reports:
    """Connection of the live registers of one drive to its motors."""

    def __init__(
        self,
        profile: DriveProfile,
        registers: Registers,
        motors: Mapping[int, Motor],
        enabled: Callable[[int], bool],
        homed: Callable[[], bool],
    ) -> None:
        self._profile = profile
        self._registers = registers
        self._motors = motors
        self._enabled = enabled
        self._homed = homed
        for motor in motors.values():
            self._bind_motor(motor)
        self._bind(profile.bus_voltage, self._supply_v)
        for name in self._watched() | {motor.channel.fault for motor in motors.values()}:
            if name is not None:
                self._bind_word(name)

    def _bind(self, name: str | None, value: Callable[[], float]) -> None:
        if name is not None:
            register = self._profile.registers[name]
            self._registers.make_live(name, lambda: raw_of(register, value()))

    def _bind_word(self, name: str) -> None:
        self._registers.make_live(name, lambda: self._status(name))

    def _bind_motor(self, motor: Motor) -> None:
        axis, channel = motor.axis, motor.channel
        self._bind(channel.velocity, lambda: motor.shown_rad_s)
        by_torque = channel.current_sign == "torque"
        self._bind(
            channel.current,
            lambda: axis.wheel.current_a * (axis.sign if by_torque else self._drawn(axis)),
        )
        self._bind(channel.temperature, lambda: axis.wheel.winding_c)
        if channel.position is not None:
            name = channel.position
            if self._profile.registers[name].unit == "turn":
                self._bind(name, lambda: self._turned_rad(motor.count or 0))
                return
            self._registers.make_live(name, lambda: self._signed(name, motor.count or 0))

    @staticmethod
    def _drawn(axis: Axis) -> float:
        """Return the sign of the power of a current that turns the wheel forward."""
        return math.copysign(1.0, axis.wheel.velocity_rad_s)

    def _turned_rad(self, count: int) -> float:
        """Return the counter as an angle, for a drive that reports its position in turns."""
        half = 1 << (self._profile.counter_bits - 1)
        return ((count + half) % (2 * half) - half) / self._profile.counts_per_turn * math.tau

    def _signed(self, name: str, word: int) -> int:
        _, high = self._profile.registers[name].raw_range
        return word if word <= high else word - self._span(name)

    def _span(self, name: str) -> int:
        low, high = self._profile.registers[name].raw_range
        return high - low + 1

    def _supply_v(self) -> float:
        register = self._profile.registers[self._profile.bus_voltage or ""]
        full_v = register.to_si(register.default) or SUPPLY_V
        drawn_a = sum(abs(motor.axis.wheel.current_a) for motor in self._motors.values())
        return full_v - SUPPLY_OHM * drawn_a

    # -------------------------------------------------------------------------------- status words
    def _watched(self) -> set[str | None]:
        """Return the registers that show whether a sequence is complete."""
        steps = (step for steps, _ in self._ends() for step in steps)
        watched: set[str | None] = {step.register for step in steps if step.value is None}
        places = (self._profile.enabled, self._profile.power_off, self._profile.homed)
        return watched | {place.register for place in places if place is not None}

    def _ends(self) -> list[tuple[tuple[Step, ...], bool]]:
        """Return the sequences, and whether each one's result is in force."""
        profile = self._profile
        enabled = [self._enabled(number) for number in self._motors]
        faultless = not any(motor.faults for motor in self._motors.values())
        return [
            (profile.arm, all(enabled)),
            (profile.disarm, not any(enabled)),
            (profile.quick_stop, not any(enabled)),
            (profile.clear_fault, faultless),
        ]

    def _status(self, name: str) -> int:
        """Return a word that fulfils exactly the profile's conditions that are true. A register
        that is also written (a control word that reads back what is in force) keeps the written
        bits if they agree."""
        word = self._registers.stored(name) % self._span(name)
        if any(motor.channel.fault == name for motor in self._motors.values()):
            word = self._faults(name)
        conditions = [
            (step.mask, step.equals or 0, true)
            for steps, true in self._ends()
            for step in steps
            if step.value is None and step.register == name
        ]
        enabled = self._profile.enabled
        if enabled is not None and enabled.register == name:
            all_enabled = all(self._enabled(number) for number in self._motors)
            conditions.append((enabled.mask, enabled.equals, all_enabled))
        if (braking := self._braking(name)) is not None:
            conditions.append(braking)
        homed = self._profile.homed
        if homed is not None and homed.register == name:
            conditions.append((homed.mask, homed.equals, self._homed()))
        for mask, equals, true in sorted(conditions, key=lambda condition: condition[2]):
            word = _with_condition(word, mask % self._span(name), equals, true=true)
        return self._signed(name, word)

    def _braking(self, name: str) -> tuple[int, int, bool] | None:
        """Return the condition by which a drive reports that it brakes although it is not enabled:
        its bits are those of [power_off] that do not show whether it is enabled."""
        power_off, enabled = self._profile.power_off, self._profile.enabled
        if power_off is None or power_off.register != name:
            return None
        if any(self._enabled(number) for number in self._motors):
            return None
        same = enabled is not None and enabled.register == name and power_off.equals == 0
        others = power_off.mask & ~enabled.mask if enabled is not None and same else 0
        braking = any(motor.braking for motor in self._motors.values())
        return others or power_off.mask, power_off.equals, not braking

    def _faults(self, name: str) -> int:
        word = 0
        for motor in self._motors.values():
            for fault in motor.faults if motor.channel.fault == name else ():
                word = fault.code if fault.code is not None else word | 1 << (fault.bit or 0)
        return word


def _with_condition(word: int, mask: int, equals: int, *, true: bool) -> int:
    """Return the nearest word for which (word & mask) == equals is true, or false."""
    if true:
        return word & ~mask | equals
    if word & mask != equals:
        return word
    return word & ~mask | (0 if equals else mask & -mask)
