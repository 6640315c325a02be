# SPDX-License-Identifier: Apache-2.0
"""A simulated motor bridge, which follows its pins at once, for as long as they keep their levels.

It has no watchdog and no sequences: a bridge has power while its pins enable it, whichever program
wrote them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from motord_hal.drives.profile import Bridge, DriveProfile
from motord_hal.sim.axis import Axis, Motor
from motord_hal.sim.pins.folder import COUNTER_BITS
from motord_hal.sim.plant import Encoder
from motord_hal.sim.positioning import GAIN_PER_S, SPEED_RAD_S
from motord_hal.sim.rs485.drive import SimulatedDrive

SERVO_DEAD_BAND_RAD = 0.003
"""Dead band of a servo on pulses: about 2 to 4 µs of the pulse."""
LEVEL_TOLERANCE = 1e-4
"""Tolerance as a part of a period. Channels take whole nanoseconds, and half of one is less than
this up to 200 kHz."""


def mode_of(bridge: Bridge, levels: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the mode and its duty, 0 to 1, that these levels of all pins mean; None: no mode. If
    braking and coasting have the same levels, it is the bridge's mode at rest."""
    for mode in (bridge.rest, "brake", "coast", "forward", "reverse"):
        pins = {pin: modes[mode] for pin, modes in bridge.levels.items()}
        duty = _duty(pins, levels)
        if all(
            abs(base + slope * duty - levels[pin]) <= LEVEL_TOLERANCE
            for pin, (base, slope) in pins.items()
        ):
            return mode, duty
    return None


def _duty(pins: Mapping[str, tuple[float, float]], levels: Mapping[str, float]) -> float:
    """Return the duty, from the first pin that shows it."""
    sent = ((levels[pin] - base) / slope for pin, (base, slope) in pins.items() if slope != 0.0)
    return max(0.0, min(1.0, next(sent, 0.0)))


class SimulatedBridge(SimulatedDrive):
    """A bridge on pins, without power until they enable it."""

    def __init__(
        self,
        profile: DriveProfile,
        unit: int,
        axes: Mapping[int, Axis],
        *,
        watchdog_s: float = 0.0,
    ) -> None:
        self._mode = "coast"
        self._duty = 0.0
        super().__init__(profile, unit, axes, watchdog_s=watchdog_s)

    def enabled(self, channel: int) -> bool:
        """Whether the bridge gives this motor power, or shorts it."""
        return super().enabled(channel) and self._mode != "coast"

    def follow(self, mode: str, duty: float) -> None:
        """Apply the present mode and duty of the pins."""
        directions = {"forward": 1.0, "reverse": -1.0}
        self._mode, self._duty = mode, duty * directions.get(mode, 0.0)
        self._apply()

    def _follow_setpoint(self, motor: Motor) -> None:
        if motor.channel.position_setpoint is not None:
            motor.axis.wheel.turn(self._servo_rad_s(motor))
            return
        # a shorted motor is like a duty of zero: its own voltage brakes it
        motor.axis.wheel.push(self._duty * motor.axis.sign, motor.axis.full_duty_rad_s)

    def _servo_rad_s(self, motor: Motor) -> float:
        """Return the speed towards the angle of the pulses."""
        full_rad = self.profile.registers[motor.channel.setpoint].si_limits[1]
        goal_rad = self._duty * full_rad / motor.axis.motor_per_wheel
        off_rad = goal_rad - motor.axis.wheel.position_rad
        if abs(off_rad) < SERVO_DEAD_BAND_RAD:
            return 0.0
        speed_rad_s = min(SPEED_RAD_S, GAIN_PER_S * abs(off_rad))
        return math.copysign(speed_rad_s, off_rad)

    # ------------------------------------------------------------------------------ its encoder
    def count_edges(self, channel: int, rad_per_count: float) -> None:
        """Put an encoder on this motor. `rad_per_count` is the wheel's angle for one count,
        signed."""
        motor = self._motors[channel]
        counts_per_turn = round(math.tau / (rad_per_count * motor.axis.motor_per_wheel))
        motor.encoder = Encoder(counts_per_turn, COUNTER_BITS)

    def count(self, channel: int) -> int | None:
        return self._motors[channel].count

    def reboot(self, now_s: float, for_s: float, *, keeps_counter: bool = False) -> None:
        """Reboot as `SimulatedDrive` does, but keep the counter: it is in the computer, which keeps
        its power."""
        del keeps_counter
        super().reboot(now_s, for_s, keeps_counter=True)

    def start_near_wrap(self) -> None:
        """Implement `SimulatedDrive.start_near_wrap`."""
        for motor in self._motors.values():
            if motor.encoder is not None:
                shaft_rad, half = motor.axis.shaft_rad, 1 << (COUNTER_BITS - 1)
                ahead = motor.encoder.count(shaft_rad + math.tau / 4 * motor.axis.sign)
                quarter = ahead - motor.encoder.count(shaft_rad)
                motor.start_at(-((quarter + half) % (2 * half) - half))
