# SPDX-License-Identifier: Apache-2.0
"""[imu]: the sensor that measures how fast the base turns, and how far it is trusted."""

from __future__ import annotations

from typing import Literal

from motord.config.sections.section import Section, number

Axis = Literal["x", "-x", "y", "-y", "z", "-z"]


class Imu(Section):
    """An inertial measurement unit whose gyro gives the heading. The defaults of its errors are
    those of the cheap chips, on the careful side."""

    up: Axis = "z"
    """The sensor's axis that points up."""
    forward: Axis = "x"
    """The sensor's axis that points forward."""
    timeout_s: float = number(
        "a sample older than this is not used: the wheels give the heading", 0.005, 1, "s", 0.1
    )
    bias_max_rad_s: float = number(
        "greatest zero-rate offset that is believed", 0.001, 2, "rad/s", 0.5
    )
    still_deviation_rad_s: float = number(
        "standard deviation of the rate while the base stands; more is a base that is shaken",
        1e-4,
        1,
        "rad/s",
        0.01,
    )
    heading_variance_rad2_per_s: float = number(
        "variance of the heading for each second: the square of the gyro's noise density",
        1e-12,
        1,
        "rad²/s",
        1e-7,
    )
    turn_variance_rad2_per_rad: float = number(
        "variance of the heading for each radian turned: the gyro's scale",
        1e-9,
        1,
        "rad²/rad",
        1e-4,
    )


class ChipImu(Imu):
    """A chip on an I2C bus of this machine."""

    source: Literal["mpu6050", "mpu6500", "mpu9250", "lsm6ds3", "lsm6dso", "ism330dhcx"]
    bus: str
    """Device file, as /dev/i2c-1."""
    address: int | None = number(
        "on the I2C bus; 0x68 (MPU) or 0x6a (LSM6DS, ISM330) where it is not given",
        0x08,
        0x77,
        "1",
        None,
    )
    rate_hz: float = number("samples a second", 20, 400, "Hz", 100.0)
    range_rad_s: float = number(
        "fastest turn that it must measure, bumps included; the chip's smallest scale that holds "
        "it is taken: 4.3, 8.7, 17 or 35 rad/s",
        0.1,
        34.9,
        "rad/s",
        8.0,
    )


class LineImu(Imu):
    """A sensor that the board on a line of kind "mcu" or "ascii" reads."""

    source: Literal["line"]
    line: str
    """Name of the line."""
