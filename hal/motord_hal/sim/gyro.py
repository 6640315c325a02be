# SPDX-License-Identifier: Apache-2.0
"""A simulated inertial sensor on the base. It measures the plant's motion, with a zero-rate offset
and white noise like those of the cheap chips (data sheet of the MPU-6050, 6.1: 0.005 °/s/√Hz, and
up to 20 °/s of offset)."""

from __future__ import annotations

import math
import random

from motord_hal.fieldbus.ports import Mounting
from motord_hal.mcu.frames import BoardImu
from motord_hal.sim.plant import Plant

NOISE_RAD_S_SQRT_S = math.radians(0.005)
"""Noise density: the deviation of a mean over one second."""
BIAS_MAX_RAD_S = math.radians(2.0)
SCALE_RAD_S = math.radians(500.0)
GRAVITY_M_S2 = 9.80665
ACCELERATION_NOISE_M_S2 = 0.02


class SimulatedGyro:
    """One sensor. The same seed gives the same offset and noise."""

    def __init__(self, plant: Plant, mounting: Mounting, seed: int, *, scale: float = 1.0) -> None:
        """Set the sensor up. `scale` is measured over true rate; these chips are within 3 % of 1
        (data sheet of the MPU-6050, 6.1)."""
        self._plant = plant
        self._mounting = mounting
        self._scale = scale
        self._random = random.Random(f"gyro {seed}")
        self.bias_rad_s = tuple(
            self._random.uniform(-BIAS_MAX_RAD_S, BIAS_MAX_RAD_S) for _ in range(3)
        )
        self._before_s, self._before_rad = plant.time_s, plant.yaw_rad

    def measure(self) -> BoardImu:
        """Return the mean rates since the last call, about the sensor's axes."""
        elapsed_s = max(self._plant.time_s - self._before_s, 1e-3)
        yaw_rad_s = (self._plant.yaw_rad - self._before_rad) / elapsed_s
        self._before_s, self._before_rad = self._plant.time_s, self._plant.yaw_rad
        deviation_rad_s = NOISE_RAD_S_SQRT_S / math.sqrt(elapsed_s)
        rates = [
            self._scale * rate + bias + self._random.gauss(0.0, deviation_rad_s)
            for rate, bias in zip((0.0, 0.0, yaw_rad_s), self.bias_rad_s, strict=True)
        ]
        felt = [
            part + self._random.gauss(0.0, ACCELERATION_NOISE_M_S2)
            for part in (0.0, 0.0, GRAVITY_M_S2)
        ]
        return BoardImu(
            self._mounting.from_base([_within(rate) for rate in rates]),
            self._mounting.from_base(felt),
            saturated=any(abs(rate) >= SCALE_RAD_S for rate in rates),
        )


def _within(rate_rad_s: float) -> float:
    return max(-SCALE_RAD_S, min(SCALE_RAD_S, rate_rad_s))
