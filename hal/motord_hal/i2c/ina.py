# SPDX-License-Identifier: Apache-2.0
"""INA219, INA226, INA228 and INA238: bus voltage, current from the voltage over a shunt, and for
the last two the chip's temperature.

Sources: the register maps of Texas Instruments' data sheets SBOS448 (INA219), SBOS547 (INA226),
SLYS021 (INA228) and SLYS025 (INA238); counts and set-up compared with the kernel's
drivers/hwmon/ina2xx.c and ina238.c. Current is shunt voltage over resistance: the chips'
calibration register is not used, so a value that another program left in it does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from motord_hal.base.errors import BadReply
from motord_hal.i2c.bus import Registers


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A measured number, and its place in a register."""

    register: int
    unit: float
    """Size of one count in V or °C."""
    shift: int = 0
    """Number of bits below the value in its register."""
    register_bytes: int = 2
    signed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Chip:
    """The differences between the chips."""

    settings: tuple[tuple[int, int], ...]
    """Registers and contents: continuous measuring of all values, averaged over some 50 to 70
    ms."""
    shunt: Field
    shunt_max: int
    """Counts at the end of the scale. A greater value was cut off."""
    bus: Field
    overflow: int = 0
    """Bit of the bus voltage register that marks computed values as wrong; 0: no such bit."""
    temperature: Field | None = None
    """The chip's own temperature; None: it is not measured."""
    identity: tuple[tuple[int, int, int], ...] = ()
    """Registers, masks and contents by which the chip is recognised."""


_TI = 0x5449
CHIPS = MappingProxyType(
    {
        # SBOS448: 32 V, gain /8 (320 mV), 128 samples of 12 bits each, mode 7; 10 uV; 4 mV, bits
        # 15..3, OVF is bit 0
        "ina219": Chip(
            settings=((0x00, 0x3FFF),),
            shunt=Field(register=0x01, unit=10e-6, signed=True),
            shunt_max=32000,
            bus=Field(register=0x02, unit=4e-3, shift=3),
            overflow=1,
        ),
        # SBOS547: mean of 16, 1.1 ms each, mode 7 (bit 14 reads as one); 2.5 uV; 1.25 mV;
        # manufacturer "TI" in register FEh
        "ina226": Chip(
            settings=((0x00, 0x4527),),
            shunt=Field(register=0x01, unit=2.5e-6, signed=True),
            shunt_max=32767,
            bus=Field(register=0x02, unit=1.25e-3),
            identity=((0xFE, 0xFFFF, _TI),),
        ),
        # SLYS021: range of 163.84 mV; mean of 16, 1.05 ms each, mode Fh; 20 of 24 bits: 312.5 nV,
        # 195.3125 uV; 7.8125 m°C; manufacturer in 3Eh, die 228h in 3Fh above its revision
        "ina228": Chip(
            settings=((0x00, 0x0000), (0x01, 0xFB6A)),
            shunt=Field(register=0x04, unit=312.5e-9, shift=4, register_bytes=3, signed=True),
            shunt_max=(1 << 19) - 1,
            bus=Field(register=0x05, unit=195.3125e-6, shift=4, register_bytes=3, signed=True),
            temperature=Field(register=0x06, unit=7.8125e-3, signed=True),
            identity=((0x3E, 0xFFFF, _TI), (0x3F, 0xFFF0, 0x2280)),
        ),
        # SLYS025: like the INA228, but 16 bits: 5 uV; 3.125 mV; 0.125 °C in bits 15..4
        "ina238": Chip(
            settings=((0x00, 0x0000), (0x01, 0xFB6A)),
            shunt=Field(register=0x04, unit=5e-6, signed=True),
            shunt_max=32767,
            bus=Field(register=0x05, unit=3.125e-3, signed=True),
            temperature=Field(register=0x06, unit=0.125, shift=4, signed=True),
            identity=((0x3E, 0xFFFF, _TI), (0x3F, 0xFFF0, 0x2380)),
        ),
    }
)


@dataclass(frozen=True, slots=True)
class Power:
    """One measurement. `current_a` is positive from IN+ to IN-; NaN beyond the chip's scale."""

    voltage_v: float
    current_a: float
    chip_c: float = float("nan")
    """Temperature of the chip itself; NaN if not measured."""


class Ina:
    """One chip that has been recognised and set up."""

    def __init__(self, kind: str, registers: Registers, shunt_ohm: float) -> None:
        """Recognise the chip and set it up. `kind` is a key of CHIPS. Raises HalError."""
        self._chip = chip = CHIPS[kind]
        self._registers = registers
        self._shunt_ohm = shunt_ohm
        for register, mask, wanted in chip.identity:
            if (found := registers.read_word(register)) & mask != wanted:
                raise BadReply(f"no {kind}: register 0x{register:02X} reads 0x{found:04X}")
        for register, value in chip.settings:
            registers.write_word(register, value)
        self._check_settings()

    def read(self) -> Power:
        """Read the values. Raises HalError, also if the chip has lost its set-up: it was without
        power, and has to be opened again."""
        self._check_settings()
        chip = self._chip
        bus, shunt = self._raw(chip.bus), self._raw(chip.shunt)
        counts = _counts(chip.shunt, shunt)
        cut_off = abs(counts) >= chip.shunt_max or bus & chip.overflow
        nothing = float("nan")
        own = chip.temperature
        return Power(
            voltage_v=_counts(chip.bus, bus) * chip.bus.unit,
            current_a=nothing if cut_off else counts * chip.shunt.unit / self._shunt_ohm,
            chip_c=_counts(own, self._raw(own)) * own.unit if own is not None else nothing,
        )

    def _raw(self, field: Field) -> int:
        if field.register_bytes == 2:
            return self._registers.read_word(field.register)
        return int.from_bytes(self._registers.read_row(field.register, field.register_bytes), "big")

    def close(self) -> None:
        """Close the I2C bus."""
        self._registers.close()

    def _check_settings(self) -> None:
        for register, wanted in self._chip.settings:
            if (found := self._registers.read_word(register)) != wanted:
                problem = f"reads 0x{found:04X}, was written 0x{wanted:04X}"
                raise BadReply(
                    f"the chip's configuration {problem}: it is another chip, or lost power"
                )


def _counts(field: Field, raw: int) -> int:
    """Return the counts in a register's raw value."""
    bits = 8 * field.register_bytes
    return (raw - (1 << bits) if field.signed and raw >> (bits - 1) else raw) >> field.shift
