# SPDX-License-Identifier: Apache-2.0
"""Gyro and accelerometer of the MPU-6050 and LSM6DS families, read through their registers.

Sources: InvenSense RM-MPU-6000A (MPU-6050), RM-MPU-6500A and RM-MPU-9250A; ST data sheets of
LSM6DS3 (DocID026899), LSM6DSO (DS12140) and ISM330DHCX (DS13012); registers and identities compared
with public drivers, among them the kernel's in drivers/iio/imu.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

from motord_hal.base.errors import BadReply
from motord_hal.i2c.bus import ByteRegisters

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of gravity, from CODATA."""
STUCK_SAMPLES = 50
"""Number of equal samples in a row, of six noisy numbers, after which the chip has stopped
converting."""
CHECK_EVERY_SAMPLES = 100
"""Interval at which the set-up is read back: a chip that was without power has lost it and reads
zero."""
_COUNTS_MAX = 32767
_FULL_MPU, _FULL_LSM = 32768.0, 1e3 / 8.75 * 250.0
"""Counts at the nominal full scale. LSM6DS: 8.75 mdps a count at 250 dps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """The differences between the families."""

    identity_register: int
    reset: tuple[int, int]
    """Register and value that reset the chip. Set-up has to wait for RESET_S afterwards."""
    ranges_dps: tuple[float, ...]
    full_counts: float
    first: int
    """First of the registers that are read in one row."""
    row: struct.Struct
    gyro_at: int
    """Position of the gyro's x in the row."""
    acceleration_at: int
    acceleration_g: float
    """Acceleration of one count."""
    default_address: int


RESET_S = 0.1
"""Time after a reset. Both families need less, and their gyros have started by then, too."""

_MPU = Family(
    identity_register=0x75,
    reset=(0x6B, 0x80),
    ranges_dps=(250.0, 500.0, 1000.0, 2000.0),
    full_counts=_FULL_MPU,
    first=0x3B,
    row=struct.Struct(">7h"),  # acceleration, temperature, gyro
    gyro_at=4,
    acceleration_at=0,
    acceleration_g=1.0 / 8192.0,
    default_address=0x68,
)
_LSM = Family(
    identity_register=0x0F,
    reset=(0x12, 0x01),
    ranges_dps=(250.0, 500.0, 1000.0, 2000.0),
    full_counts=_FULL_LSM,
    first=0x22,
    row=struct.Struct("<6h"),  # gyro, acceleration
    gyro_at=0,
    acceleration_at=3,
    acceleration_g=0.122e-3,
    default_address=0x6A,
)
CHIPS = MappingProxyType(
    {
        "mpu6050": (_MPU, (0x68,)),
        "mpu6500": (_MPU, (0x70,)),
        "mpu9250": (_MPU, (0x71, 0x73)),
        "lsm6ds3": (_LSM, (0x69, 0x6A)),
        "lsm6dso": (_LSM, (0x6C,)),
        "ism330dhcx": (_LSM, (0x6B,)),
    }
)
"""Name of a chip → its family, and the possible values of its identity register."""


def _set_up_mpu(rate_hz: float, range_place: int) -> tuple[tuple[int, int], ...]:
    """Return the set-up: clock from the gyro's PLL; low pass of 44 Hz (DLPF 3), which makes the
    internal rate 1 kHz; divider; ±4 g."""
    divider = min(max(round(1000.0 / rate_hz) - 1, 0), 255)
    return (0x6B, 0x01), (0x1A, 0x03), (0x19, divider), (0x1B, range_place << 3), (0x1C, 0x08)


def _set_up_lsm(rate_hz: float, range_place: int) -> tuple[tuple[int, int], ...]:
    """Return the set-up: both bytes of a number from one sample (BDU), automatic increment of the
    register address; ±4 g; twice the reading rate, at 208, 416 or 833 Hz."""
    rate = 0x50 if rate_hz <= 104.0 else 0x60 if rate_hz <= 208.0 else 0x70
    return (0x12, 0x44), (0x10, rate | 0x08), (0x11, rate | range_place << 2)


@dataclass(frozen=True, slots=True)
class Motion:
    """One sample, about the sensor's own axes."""

    angular_rad_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    saturated: bool
    """Whether a rate is at the end of the scale."""


class ImuChip:
    """One chip that has been recognised and set up."""

    def __init__(
        self,
        kind: str,
        registers: ByteRegisters,
        *,
        rate_hz: float,
        range_rad_s: float,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Recognise the chip and set it up. `kind` is a key of CHIPS. The smallest scale that
        includes `range_rad_s` is used. Blocks for twice RESET_S. Raises HalError."""
        self._family, identities = CHIPS[kind]
        self._registers = registers
        found = registers.read_byte(self._family.identity_register)
        if found not in identities:
            at = f"register 0x{self._family.identity_register:02X} reads 0x{found:02X}"
            raise BadReply(f"no {kind}: {at}{_meant(self._family, found)}")
        place = range_place(self._family, range_rad_s)
        self.full_scale_rad_s = math.radians(self._family.ranges_dps[place])
        self._rad_s = self.full_scale_rad_s / self._family.full_counts
        set_up = _set_up_mpu if self._family is _MPU else _set_up_lsm
        self._kept = set_up(rate_hz, place)
        registers.write_byte(*self._family.reset)
        sleep(RESET_S)
        for register, value in self._kept:
            registers.write_byte(register, value)
        self._check()
        sleep(RESET_S)
        self._samples = self._equal = 0
        self._before = b""

    def read(self) -> Motion:
        """Read one sample. Raises HalError, also if the chip has lost its set-up or repeats one
        sample: it has to be opened again."""
        family = self._family
        data = self._registers.read_row(family.first, family.row.size)
        self._samples += 1
        if self._samples % CHECK_EVERY_SAMPLES == 0:
            self._check()
        self._equal = self._equal + 1 if data == self._before else 0
        self._before = data
        if self._equal >= STUCK_SAMPLES:
            raise BadReply(
                f"the sensor has sent the same sample {STUCK_SAMPLES} times: it stands still"
            )
        counts = family.row.unpack(data)
        gyro = counts[family.gyro_at : family.gyro_at + 3]
        acceleration = counts[family.acceleration_at : family.acceleration_at + 3]
        limit = min(_COUNTS_MAX, math.floor(family.full_counts))
        scale_m_s2 = family.acceleration_g * STANDARD_GRAVITY_M_S2
        return Motion(
            angular_rad_s=tuple(count * self._rad_s for count in gyro),
            acceleration_m_s2=tuple(count * scale_m_s2 for count in acceleration),
            saturated=any(abs(count) >= limit for count in gyro),
        )

    def close(self) -> None:
        """Close the I2C bus."""
        self._registers.close()

    def _check(self) -> None:
        for register, value in self._kept:
            if (found := self._registers.read_byte(register)) != value:
                problem = (
                    f"register 0x{register:02X} reads 0x{found:02X}, was written 0x{value:02X}"
                )
                raise BadReply(f"the chip has lost its set-up: {problem}")


def range_place(family: Family, range_rad_s: float) -> int:
    """Return the index of the smallest scale that includes the range, else of the largest scale."""
    for place, range_dps in enumerate(family.ranges_dps):
        if math.radians(range_dps) >= range_rad_s:
            return place
    return len(family.ranges_dps) - 1


def _meant(family: Family, found: int) -> str:
    for kind, (of, identities) in CHIPS.items():
        if of is family and found in identities:
            return f": it is an {kind}"
    return ""
