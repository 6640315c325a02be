# SPDX-License-Identifier: Apache-2.0
"""INA219 and INA226: bus voltage, and current by the voltage over a shunt.

Sources: the register maps of Texas Instruments' data sheets SBOS448 (INA219) and SBOS547 (INA226);
counts and set-up compared with the kernel's drivers/hwmon/ina2xx.c. Current is shunt voltage over
resistance: the chips' calibration register is not used, so that nobody else's value in it counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from motord_hal.errors import BadReply
from motord_hal.i2c.bus import Registers

_CONFIGURATION, _SHUNT, _BUS = 0x00, 0x01, 0x02


@dataclass(frozen=True, slots=True, kw_only=True)
class Chip:
    """What differs between the two."""

    configuration: int
    """Continuous measuring of both, averaged over some 70 ms where the chip can."""
    shunt_v: float
    """Of one count of the shunt register, two's complement."""
    shunt_max: int
    """Counts at the end of the scale: what reads more was cut off."""
    bus_v: float
    """Of one count of the bus register."""
    bus_shift: int
    """Bits below the voltage in the bus register."""
    overflow: int
    """Bit of the bus register: what was computed from it is wrong."""
    identity: tuple[int, int] | None
    """Register and content by which the chip is known."""


CHIPS = MappingProxyType(
    {
        # SBOS448: 32 V, gain /8 (320 mV), 128 samples of 12 bits each, mode 7; 10 uV; 4 mV, bits
        # 15..3, OVF is bit 0
        "ina219": Chip(
            configuration=0x3FFF,
            shunt_v=10e-6,
            shunt_max=32000,
            bus_v=4e-3,
            bus_shift=3,
            overflow=1,
            identity=None,
        ),
        # SBOS547: mean of 16, 1.1 ms each, mode 7 (bit 14 reads as one); 2.5 uV; 1.25 mV;
        # manufacturer "TI" in register FEh
        "ina226": Chip(
            configuration=0x4527,
            shunt_v=2.5e-6,
            shunt_max=32767,
            bus_v=1.25e-3,
            bus_shift=0,
            overflow=0,
            identity=(0xFE, 0x5449),
        ),
    }
)


@dataclass(frozen=True, slots=True)
class Power:
    """One measure. `current_a` is positive from IN+ to IN-; NaN beyond the chip's scale."""

    voltage_v: float
    current_a: float


class Ina:
    """One chip that has been recognised and set up."""

    def __init__(self, kind: str, registers: Registers, shunt_ohm: float) -> None:
        """`kind`: of CHIPS. Raises HalError."""
        self._chip = chip = CHIPS[kind]
        self._registers = registers
        self._shunt_ohm = shunt_ohm
        if chip.identity is not None:
            register, wanted = chip.identity
            if (found := registers.read_word(register)) != wanted:
                raise BadReply(f"no {kind}: register 0x{register:02X} reads 0x{found:04X}")
        registers.write_word(_CONFIGURATION, chip.configuration)
        self._check_configuration()

    def read(self) -> Power:
        """Raises HalError, also where the chip has lost its set-up: it was without power then, and
        has to be opened again."""
        self._check_configuration()
        bus = self._registers.read_word(_BUS)
        shunt = self._registers.read_word(_SHUNT)
        signed = shunt - 0x10000 if shunt & 0x8000 else shunt
        cut_off = abs(signed) >= self._chip.shunt_max or bus & self._chip.overflow
        current_a = signed * self._chip.shunt_v / self._shunt_ohm
        return Power(
            voltage_v=(bus >> self._chip.bus_shift) * self._chip.bus_v,
            current_a=float("nan") if cut_off else current_a,
        )

    def close(self) -> None:
        """Lets go of the bus."""
        self._registers.close()

    def _check_configuration(self) -> None:
        found = self._registers.read_word(_CONFIGURATION)
        if found != self._chip.configuration:
            said = f"reads 0x{found:04X}, was written 0x{self._chip.configuration:04X}"
            raise BadReply(f"the chip's configuration {said}: it is another chip, or lost power")
