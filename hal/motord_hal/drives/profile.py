# SPDX-License-Identifier: Apache-2.0
"""A drive profile as values: the checked content of config/drives/NAME.toml. `load.py` reads it.

Drive units (rpm, 0.1 A, per cent) exist only here: `Register.to_si` and `Register.from_si` are the
only conversions.
"""

from __future__ import annotations

import enum
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from motord_hal.drives.can_profile import CanTable


class RegisterType(enum.StrEnum):
    """Width and sign of a register. A 32-bit value comes high word first unless the name
    differs. Modbus registers have no 8-bit and no floating-point types; places in the frames of
    other protocols may."""

    U8 = "u8"
    I8 = "i8"
    U16 = "u16"
    U16_HIGH_FIRST = "u16-high-first"
    """High byte first, for a series of bus servos (Feetech SCS); registers of Modbus are u16."""
    I16 = "i16"
    U32 = "u32"
    I32 = "i32"
    U32_LOW_FIRST = "u32-low-first"
    I32_LOW_FIRST = "i32-low-first"
    F32 = "f32"
    M16 = "m16"
    """The top bit is the sign, the others are the magnitude (bus servos)."""
    M16_BIT10_HIGH_FIRST = "m16-bit10-high-first"
    """The same as `m16`, but with the sign in bit 10 and the high byte first (Feetech SCS)."""

    @functools.cached_property
    def bits(self) -> int:
        return int(self.value.split("-")[0][1:])

    @functools.cached_property
    def words(self) -> int:
        return 2 if self.bits > 16 else 1

    @functools.cached_property
    def signed(self) -> bool:
        return self.value.startswith(("i", "f", "m"))

    @functools.cached_property
    def high_first(self) -> bool:
        return self.value.endswith("high-first")

    @functools.cached_property
    def magnitude(self) -> bool:
        return self.value.startswith("m")

    @functools.cached_property
    def sign_bit(self) -> int:
        """Position of the sign bit of a signed type, which is also the number of bits below it."""
        return 10 if self is RegisterType.M16_BIT10_HIGH_FIRST else self.bits - 1


# drive unit → (SI unit, SI per drive unit, SI at drive zero)
SI_UNITS = MappingProxyType(
    {
        "": ("", 1.0, 0.0),
        "count": ("count", 1.0, 0.0),
        "rpm": ("rad/s", 2.0 * math.pi / 60.0, 0.0),
        "rad/s": ("rad/s", 1.0, 0.0),
        "turn": ("rad", 2.0 * math.pi, 0.0),
        "turn/s": ("rad/s", 2.0 * math.pi, 0.0),
        "percent": ("1", 0.01, 0.0),
        "n_m": ("N·m", 1.0, 0.0),
        "a": ("A", 1.0, 0.0),
        "v": ("V", 1.0, 0.0),
        "c": ("°C", 1.0, 0.0),
        "s": ("s", 1.0, 0.0),
        "ms": ("s", 0.001, 0.0),
    }
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Register:
    """One holding register, or two for a 32-bit value. SI value = raw × scale × (SI per unit)."""

    name: str
    address: int
    type: RegisterType
    scale: float
    unit: str
    access: str
    """"r", "w" or "rw"."""
    minimum: float | None
    """Smallest value that the drive accepts, in `unit`."""
    maximum: float | None
    source: str
    mask: int | None = None
    """Adjacent bits of the word that hold the value (two temperatures in one word); read only."""
    default: int = 0
    """Raw value of the whole word at power-up; the simulator starts with it."""

    def to_si(self, raw: int) -> float:
        _, per_unit, _ = SI_UNITS[self.unit]
        return raw * self.scale * per_unit

    def from_si(self, value: float) -> int:
        """Return the nearest raw value within the register's limits. Raises ValueError for NaN and
        infinity."""
        if not math.isfinite(value):
            raise ValueError(f"{self.name}: {value} cannot be written")
        _, per_unit, _ = SI_UNITS[self.unit]
        in_unit = value / per_unit
        if self.minimum is not None:
            in_unit = max(in_unit, self.minimum)
        if self.maximum is not None:
            in_unit = min(in_unit, self.maximum)
        low, high = self.raw_range
        return round(min(max(in_unit / self.scale, low), high))

    def decode(self, words: tuple[int, ...]) -> int:
        """Return the raw value of these words, which are in the order of the wire."""
        value = words[0]
        if self.type.words == 2:
            low_first = self.type.value.endswith("low-first")
            high, low = (words[1], words[0]) if low_first else (words[0], words[1])
            value = high << 16 | low
        bits = self.type.bits
        if self.mask is not None:
            value = (value & self.mask) // (self.mask & -self.mask)
            bits = self.mask.bit_count()
        return value - (1 << bits) if self.type.signed and value >> (bits - 1) else value

    @property
    def si_limits(self) -> tuple[float, float]:
        """Least and greatest value in SI, by the type and by `minimum` and `maximum` where
        given."""
        low, high = sorted(self.to_si(raw) for raw in self.raw_range)
        per_unit = SI_UNITS[self.unit][1]
        if self.minimum is not None:
            low = max(low, self.minimum * per_unit)
        if self.maximum is not None:
            high = min(high, self.maximum * per_unit)
        return low, high

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw value of the type."""
        bits = self.type.bits
        if not self.type.signed:
            return 0, (1 << bits) - 1
        most = (1 << self.type.sign_bit) - 1
        return -most - (not self.type.magnitude), most

    def encode(self, raw: int) -> tuple[int, ...]:
        """Return the words for the wire. Raises ValueError if the value does not fit."""
        bits = self.type.bits
        low, high = self.raw_range
        if not low <= raw <= high:
            raise ValueError(f"{self.name}: {raw} does not fit {self.type.value}")
        raw &= (1 << bits) - 1
        if bits <= 16:
            return (raw,)
        words = (raw >> 16, raw & 0xFFFF)
        return words[::-1] if self.type.value.endswith("low-first") else words


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """Register of the direction, and its values, for drives whose set-point is a magnitude.
    A velocity that such a drive measures without sign takes the sign of the last direction."""

    register: str
    forward: int
    reverse: int
    rest: int
    """Value written with a set-point of zero."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Handshake:
    """Bits by which a drive takes a target. The rising edge of the bit in `register` hands the
    target over; the drive sets the acknowledging bit until the first one is 0 again (CiA 402-2,
    profile position: new set-point)."""

    register: str
    mask: int
    """Mask with one bit set."""
    acknowledged: str
    """Name of the register with the acknowledging bit."""
    acknowledged_mask: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """The registers of one motor of the drive, by name; None: the drive has no such register."""

    velocity_setpoint: str | None = None
    duty_setpoint: str | None = None
    torque_setpoint: str | None = None
    """Register of the motor's torque. The core then runs the speed loop."""
    position_setpoint: str | None = None
    """Register of the target position, in the unit of `position` and from the same origin. Exactly
    one of the four set-points exists."""
    move_velocity: str | None = None
    """Register of the speed at which the drive moves to a position; see `moves_at_rad_s`."""
    position_least: str | None = None
    position_greatest: str | None = None
    """Registers of the range that the drive keeps by itself, in the unit of `position`. If the
    least is not below the greatest, the drive keeps none."""
    setpoint_with: tuple[tuple[str, int], ...] = ()
    """Pairs (register, raw value) that are written in one request with each set-point. Their
    arrival makes the drive follow the set-point."""
    handshake: Handshake | None = None
    """Handshake of a drive that takes a target only by one; None: no handshake is needed."""
    position: str | None = None
    velocity: str | None = None
    current: str | None = None
    current_sign: str = "torque"
    """"torque": a signed current is positive while the motor pushes forward; "power": while the
    drive draws power, in either direction."""
    temperature: str | None = None
    fault: str | None = None
    direction: Direction | None = None

    @property
    def setpoint(self) -> str:
        """Name of the set-point's register."""
        setpoints = (self.velocity_setpoint, self.duty_setpoint, self.torque_setpoint)
        return next(filter(None, (*setpoints, self.position_setpoint)), "")

    def to_motor(self, gear_ratio: float) -> float:
        """Return the motor's set-point for a set-point of 1 at the wheel. A gear makes the speed
        higher and the torque lower; a duty stays the same."""
        if self.torque_setpoint is not None:
            return 1.0 / gear_ratio
        return 1.0 if self.duty_setpoint is not None else gear_ratio

    @property
    def commands(self) -> frozenset[str]:
        """Names of all registers that command the motor."""
        direction = (self.direction.register,) if self.direction else ()
        return frozenset({self.setpoint, *direction, *dict(self.setpoint_with)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of a sequence: a write (`value` is set), or a wait until (register & mask) ==
    equals."""

    register: str
    value: int | None = None
    mask: int = 0xFFFFFFFF
    equals: int | None = None
    within_s: float = 0.0
    """For a wait: longest time."""
    plus_node: bool = False
    """For a write: whether the drive's node number is added to the value."""
    cycle: bool = False
    """For a write: whether the value is the line's cycle time, in the unit of the register."""
    verify: bool = True
    """For a write: whether the register keeps the written value, so that it can be read back."""
    copy_of: str = ""
    """For a write: name of the register whose raw value, read right before, is written."""
    if_different: bool = False
    """For a write: whether to write only if the register holds another value. Memory that survives
    a power cut wears with each write."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Enabled:
    """Condition under which the drive, with all its channels, is enabled: (register & mask) ==
    equals."""

    register: str
    mask: int
    equals: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """What a drive of this profile reports of itself: (register & mask) is one of `values`."""

    register: str
    mask: int
    values: tuple[int, ...]
    others: tuple[tuple[int, str], ...] = ()
    """Pairs (value, name) of other drives, to name the one that answers."""

    def name_of(self, value: int) -> str:
        """Return the name of the other drive that reports this value; empty: it is not known."""
        return dict(self.others).get(value, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Watchdog:
    """The drive's own communication watchdog. `register` holds its time limit."""

    register: str
    minimum_s: float
    maximum_s: float
    action: str
    """What the drive does when the watchdog expires, in words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultBit:
    """One fault: either a bit of the fault word or, on drives with numbered faults, a code. Only
    one of the two fields has a value."""

    bit: int | None
    code: int | None = None
    text: str
    severity: str
    """"fault" stops the robot; "warning" is only reported."""


BRIDGE_MODES = ("coast", "brake", "forward", "reverse")


@dataclass(frozen=True, slots=True, kw_only=True)
class Bridge:
    """A motor bridge as data: the level of each pin in each mode."""

    pwm_hz: float
    """Carrier frequency, unless the robot file sets another one."""
    pwm_min_hz: float
    pwm_max_hz: float
    rest: str
    """Mode at a duty of zero while armed: "brake" or "coast"."""
    levels: dict[str, dict[str, tuple[float, float]]]
    """Pin → mode → (base, slope): its level, 0 to 1, is base + slope × |duty|."""

    def needs_pwm(self, pin: str) -> bool:
        """Whether the pin takes other levels than low and high."""
        return any(
            base not in (0.0, 1.0) or slope != 0.0 for base, slope in self.levels[pin].values()
        )


class Gap(enum.StrEnum):
    """Rules for the silent interval (MODBUS over Serial Line V1.02, 2.5.1.1)."""

    SPEC = "spec"
    """3.5 characters; above 19200 baud 1.75 ms."""
    CHARACTERS = "3.5char"
    """3.5 characters at every baud rate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveProfile:
    name: str
    title: str
    protocol: str
    source: str
    path: Path
    baudrate: int
    parity: str
    stop_bits: int
    unit: int
    turnaround_s: float
    """Longest time from the request's last byte to the reply's first one."""
    gap: Gap = Gap.SPEC
    """Silent interval that this drive needs before a request."""
    gap_s: float | None
    """Silent interval in seconds; None: `gap` applies."""
    max_registers: int
    """Greatest number of registers in one request."""
    write_function: int
    """Modbus function that writes set-points: 6 or 16."""
    read_write_function: int | None = None
    """23 if the drive can read and write in one exchange; None: it cannot."""
    broadcast_stop: bool = False
    """Whether the drive carries out writes to unit 0, so that one frame stops all drives of the
    line."""
    counts_per_turn: int
    """Counts for one turn of the motor shaft; 0: no position counter."""
    speed_in_counts: bool = False
    """Whether speeds are counts a second on the wire. They need `counts_per_turn` then."""
    counter_bits: int
    registers: dict[str, Register]
    channels: dict[int, Channel]
    configure: tuple[Step, ...]
    arm: tuple[Step, ...]
    disarm: tuple[Step, ...]
    quick_stop: tuple[Step, ...]
    clear_fault: tuple[Step, ...]
    identity: tuple[Identity, ...] = ()
    """What is read at each set-up, before anything is written; empty: the drive reports nothing by
    which it could be recognised."""
    enabled: Enabled | None
    """None: the drive cannot report whether it is enabled."""
    power_off: Enabled | None = None
    """The motor has no power when this holds. None: the motor has no power when not `enabled`."""
    absolute: bool = False
    """Whether the position means the same after each power-up."""
    homed: Enabled | None = None
    """The position has a reference when this holds; None: the drive cannot report it."""
    watchdog: Watchdog | None
    watchdog_note: str
    """Why there is no watchdog, and what to do instead; empty if there is one."""
    watchdog_fixed_s: float = 0.0
    """The drive stops by itself after this time of silence, which can neither be set nor read; 0:
    the drive does not stop by itself."""
    unknown: tuple[str, ...] = ()
    """Facts about the drive that are not known."""
    faults: tuple[FaultBit, ...]
    bus_voltage: str | None
    can: CanTable | None = None
    """Frames of a drive on a CAN bus, whose registers are signals in them; None: another wire."""
    bridge: Bridge | None = None
    """Only for the protocol "pwm"."""

    @property
    def goes_to_positions(self) -> bool:
        return any(channel.position_setpoint for channel in self.channels.values())

    def moves_at_rad_s(self, channel: Channel) -> float:
        """Return the speed at which the drive moves to a position, at the motor: what motord writes
        to `move_velocity`. inf: no bound is known."""
        name = channel.move_velocity
        if name is None:
            return math.inf
        written = {step.register: step.value for step in self.configure}
        raw = {**written, **dict(channel.setpoint_with)}.get(name)
        return abs(self.registers[name].to_si(raw)) if raw else math.inf

    def faults_in(self, word: int) -> tuple[FaultBit, ...]:
        """Return the faults in a fault word. A bit or code that the profile does not list counts as
        a fault, too."""
        if word == 0:
            return ()
        if any(fault.code is not None for fault in self.faults):
            known = tuple(fault for fault in self.faults if fault.code == word)
            unlisted = f"unlisted fault code {word}"
            return known or (FaultBit(bit=None, code=word, text=unlisted, severity="fault"),)
        by_bit = {fault.bit: fault for fault in self.faults}
        return tuple(
            by_bit.get(bit) or FaultBit(bit=bit, text=f"unlisted fault bit {bit}", severity="fault")
            for bit in range(word.bit_length())
            if word >> bit & 1
        )

    def stopping_faults(self, word: int) -> int:
        """Return the fault word without its warnings; 0: no fault stops the robot."""
        kept = 0
        for fault in self.faults_in(word):
            if fault.severity == "fault":
                kept |= word if fault.bit is None else 1 << fault.bit
        return kept
