# SPDX-License-Identifier: Apache-2.0
"""The drive profile as its file writes it: each table with its keys, their types and ranges. What
follows only from several of them together is checked in `check.py`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, StringConstraints, Tag

from motord.config.drives.can_tables import (
    CanBus,
    CanFrame,
    CanObject,
    CanSignal,
    DbcFile,
    EdsFile,
    ReservedIds,
)
from motord.config.drives.parts import (
    CHANNEL,
    RAW_MAX,
    RAW_MIN,
    WHOLE,
    Access,
    Mask,
    PartName,
    Scaled,
    Text,
    Unit,
)
from motord.config.sections.section import Field, Section, number

Protocol = Literal[
    "modbus-rtu",
    "ddsm",
    "can",
    "mcu-frame",
    "ascii",
    "roboclaw",
    "hoverboard",
    "hoverboard-steer",
    "sabertooth",
    "pwm",
    "feetech",
    "dynamixel",
]
ChannelNumber = Annotated[str, StringConstraints(pattern=CHANNEL)]


class SerialWire(Section):
    """[serial]: the drive on a serial line, as delivered."""

    baudrate: int = number("bits a second", 300, 4_500_000, "1/s")
    parity: Literal["none", "even", "odd"]
    """Parity bit of each character."""
    stop_bits: Annotated[Literal[1, 2], WHOLE]
    """Stop bits of each character."""
    unit: int = number("the drive's address", 1, 247, "1")
    turnaround_s: float = number(
        "longest time from the request's last byte to the reply's first one", 1e-5, 1.0, "s"
    )
    gap: Literal["spec", "3.5char"] = "spec"
    """Silent interval before a request: that of the Modbus specification, or 3.5 characters at
    every baud rate."""
    gap_s: float | None = number("the same interval as a time", 1e-5, 0.1, "s", None)
    max_registers: int | None = number("most registers in one request", 1, 123, "1", None)
    write_function: Annotated[Literal[6, 16], WHOLE] | None = None
    """Modbus function that writes set-points."""
    read_write_function: Annotated[Literal[23], WHOLE] | None = None
    """Modbus function that reads and writes in one exchange, if the drive has it."""
    broadcast_stop: bool = False
    """The drive accepts writes to unit 0: one frame stops all drives of the line."""


class Motor(Section):
    """[motor]: the motor of the drive."""

    counts_per_turn: int = number("encoder counts of a motor turn; 0: none", 0, 1 << 30, "1", 0)
    counter_bits: Annotated[Literal[0, 8, 12, 15, 16, 24, 32], WHOLE] = 0
    """Width of the position counter in bits; 0: no counter."""
    pole_pairs: int = number("pole pairs; 0: not needed", 0, 100, "1", 0)


class HoldingRegister(Scaled):
    """[register.NAME]: one value of the drive."""

    address: int = number("Modbus address, or the place that the protocol gives it", 0, 65535, "1")
    type: Literal[
        "u8", "i8", "u16", "i16", "u32", "i32", "u32-low-first", "i32-low-first", "m16",
        "u16-high-first", "m16-bit10-high-first",
    ]  # fmt: skip
    """Width and sign; two words come high word first unless the name has another order; m16 is a
    sign bit and a magnitude. A bus servo's bytes come low byte first unless the name has another
    order."""
    unit: Literal[Unit, "hz", "count/s"] = ""
    """Unit of the scaled value."""
    access: Access
    """What motord may do with it: read, write, or both."""
    source: Text
    """The page or table where this can be checked."""
    mask: int | None = number("adjacent bits of the word that hold it", 1, 65535, "1", None)


class ReverseRegister(Section):
    """[channel.N.direction]: the register of the direction, for a set-point that is a magnitude."""

    register_name: Text = Field(alias="register")
    """The register that holds the direction."""
    forward: int = number("its value for forward", 0, 65535, "1")
    reverse: int = number("its value for reverse", 0, 65535, "1")
    rest: int = number("its value with a set-point of zero", 0, 65535, "1")


class TargetHandshake(Section):
    """[channel.N.handshake]: the drive takes a target with the rising edge of a bit."""

    register_name: Text = Field(alias="register")
    """The signal that has the bit, in the frame of the set-point."""
    mask: int = number("the bit", 1, (1 << 32) - 1, "1")
    acknowledged: Text
    """The signal by which the drive reports that it has taken the target."""
    acknowledged_mask: int = number("its bit for that", 1, (1 << 32) - 1, "1")


class MotorChannel(Section):
    """[channel.N]: one motor of the drive, by the names of its registers."""

    velocity_setpoint: Text | None = None
    """Register of the velocity that the motor shall have."""
    duty_setpoint: Text | None = None
    """Register of the duty that the motor shall have."""
    torque_setpoint: Text | None = None
    """Register of the torque that the motor shall have; motord closes the speed loop."""
    position_setpoint: Text | None = None
    """Register of the position that the motor shall go to, in the unit of `position`."""
    move_velocity: Text | None = None
    """Register of the speed at which the drive moves to a position. Its value stands in
    `setpoint_with` or in a step of `configure`; 0 there: the drive has no bound of its own."""
    position_least: Text | None = None
    """Register of the least position that the drive itself allows, in the unit of `position`."""
    position_greatest: Text | None = None
    """Register of the greatest position that the drive itself allows."""
    position: Text | None = None
    """Register of the position."""
    velocity: Text | None = None
    """Register of the measured velocity."""
    current: Text | None = None
    """Register of the motor current."""
    current_sign: Literal["torque", "power"] = "torque"
    """Meaning of the sign of the current: positive while the motor pushes forward, or while the
    drive draws power in either direction."""
    temperature: Text | None = None
    """Register of the temperature."""
    fault: Text | None = None
    """Register of the fault word."""
    direction: ReverseRegister | None = None
    """Register of the direction, for a set-point without sign."""
    setpoint_with: dict[str, Annotated[int, Field(ge=-(1 << 15), le=(1 << 16) - 1)]] = Field(
        default_factory=dict
    )
    """Registers that get a fixed raw value in the same request as each set-point."""
    handshake: TargetHandshake | None = None
    """Handshake, for a drive on a CAN bus that takes a position only with one."""


class WriteStep(Section):
    """A step that writes a register."""

    write: Text
    """The register to write."""
    value: int | None = number("raw value", RAW_MIN, RAW_MAX, "1", None)
    verify: bool = True
    """Whether the register keeps what was written, so that it can be read back."""
    if_different: bool = False
    """Whether it is read before, and written only if it holds another value: for memory that
    wears."""
    plus_node: bool = False
    """Whether the drive's own node number is added to the value."""
    cycle: bool = False
    """Whether the value is the time of the line's cycle, in the unit of the register."""


class WaitStep(Section):
    """A step that waits until (register & mask) = equals."""

    wait: Text
    """The register to read."""
    mask: int = Mask(0xFFFFFFFF)
    equals: int = number("raw value to wait for", 0, 0xFFFFFFFF, "1")
    within_s: float = number("longest time", 0.001, 10.0, "s")


def _kind_of_step(step: Any) -> str | None:
    keys = step if isinstance(step, dict) else ()
    return {(True, False): "WriteStep", (False, True): "WaitStep"}.get(
        ("write" in keys, "wait" in keys)
    )


AnyStep = Annotated[
    Annotated[WriteStep, Tag("WriteStep")] | Annotated[WaitStep, Tag("WaitStep")],
    Discriminator(
        _kind_of_step,
        custom_error_type="no_step",
        custom_error_message='a step has either "write" or "wait"',
    ),
]


class Sequences(Section):
    """[steps]: what motord writes to the drive, in order."""

    configure: list[AnyStep] = Field(default_factory=list)
    """Steps that are taken once, when the drive is found."""
    arm: list[AnyStep] = Field(default_factory=list)
    """Steps before the first set-point."""
    disarm: list[AnyStep] = Field(default_factory=list)
    """Steps that take the motor's power."""
    quick_stop: list[AnyStep] = Field(default_factory=list)
    """Steps that stop the motor as fast as the drive can."""
    clear_fault: list[AnyStep] = Field(default_factory=list)
    """Steps that leave a fault, when a person requests it."""


class IdentityRead(Section):
    """[[identity]]: what the drive reports of itself. It is read at each set-up, before anything is
    written: (register & mask) is one of the values."""

    register_name: Text = Field(alias="register")
    """The register to read."""
    mask: int = Mask()
    values: list[Annotated[int, WHOLE]]
    """Values of a drive that this profile is for."""
    others: dict[Annotated[str, StringConstraints(pattern=r"^[0-9]{1,10}$")], Text] = Field(
        default_factory=dict
    )
    """Names of other drives by the value that they report, for the message."""


class EnabledWhen(Section):
    """[enabled]: the drive has power when (register & mask) = equals."""

    register_name: Text = Field(alias="register")
    """The register to read."""
    mask: int = Mask()
    equals: int = number("its value then", 0, 0xFFFFFFFF, "1")


class PowerOffWhen(EnabledWhen):
    """[power_off]: the motor has no power when (register & mask) = equals. For a drive that is not
    enabled any more while it brakes with power."""

    equals: int = number("its value then", 0, 0xFFFFFFFF, "1")


class HomedWhen(EnabledWhen):
    """[homed]: the position has a reference when (register & mask) = equals."""


class DriveWatchdog(Section):
    """[watchdog]: the drive's own communication watchdog."""

    register_name: Text = Field(alias="register")
    """The register that holds the watchdog's time."""
    minimum_s: float = number("shortest time that it takes", 0.001, 3600.0, "s")
    maximum_s: float = number("longest time that it takes", 0.001, 3600.0, "s")
    action: Text
    """What the drive does when the time is over, in words."""


class FaultCode(Section):
    """[[fault]]: one fault, by its bit or by its code."""

    bit: int | None = number("its bit in the fault word", 0, 31, "1", None)
    code: int | None = number("its number, on drives that number them", 1, 65535, "1", None)
    text: Text
    """What is wrong, in words."""
    severity: Literal["fault", "warning"]
    """A fault stops the robot."""


class LevelLine(Section):
    """A pin's level as base + slope × |duty|."""

    base: float = number("level at a duty of 0", 0.0, 1.0, "1")
    slope: float = number("level for each 1 of duty", -1.0, 1.0, "1", 0.0)


PinLevel = Annotated[
    Annotated[Literal["low", "high", "duty", "inverse"], Tag("word")]
    | Annotated[LevelLine, Tag("LevelLine")],
    Discriminator(lambda level: "LevelLine" if isinstance(level, dict) else "word"),
]
Pins = dict[str, PinLevel]


class MotorBridge(Section):
    """[bridge]: which level each pin of a motor bridge has in each mode."""

    pwm_hz: float = number("carrier frequency", 10.0, 1e6, "Hz", 20000.0)
    pwm_min_hz: float = number("lowest carrier frequency", 10.0, 1e6, "Hz", 10.0)
    pwm_max_hz: float = number("highest carrier frequency", 10.0, 1e6, "Hz")
    rest: Literal["brake", "coast"] = "brake"
    """Mode at a duty of zero while armed."""
    coast: Pins
    """Levels without power."""
    brake: Pins
    """Levels that short the motor, so that it brakes."""
    forward: Pins
    """Levels that drive the motor forward."""
    reverse: Pins
    """Levels that drive the motor in reverse."""


def _one_line(value: Any) -> Any:
    return " ".join(value.split()) if isinstance(value, str) else value


class DriveFile(Section):
    """A drive profile: docs/drives/README.md."""

    model_config = ConfigDict(
        json_schema_extra={
            "if": {"properties": {"protocol": {"const": "can"}}},
            "then": {"required": ["can", "frame"]},
            "else": {"required": ["serial", "register"]},
        }
    )

    schema_version: Annotated[Literal[1], WHOLE] = Field(alias="schema")
    """Version of this format."""
    name: Text
    """The file's name without its ending."""
    title: Annotated[Text, BeforeValidator(_one_line)]
    """Maker and model of the drive."""
    protocol: Protocol
    """Protocol that the drive speaks."""
    source: Text
    """Source of this profile: manual, version, table."""
    bus_voltage: Text | None = None
    """Register of the supply voltage."""
    absolute: bool = False
    """Whether the position means the same after each power-up: an absolute encoder on the
    output."""
    watchdog_fixed_s: float | None = number(
        "time of a communication watchdog that can neither be set nor read",
        0.001,
        3600.0,
        "s",
        None,
    )
    watchdog_note: Text | None = None
    """Why there is no [watchdog], and what to do instead."""
    unknown: list[
        Literal[
            "serial", "sign", "order", "scale", "range", "start", "enable", "velocity",
            "watchdog", "source",
        ]
    ] = Field(default_factory=list)  # fmt: skip
    """Facts about the drive that are not known."""
    serial: SerialWire | None = None
    can: CanBus | None = None
    dbc: DbcFile | None = None
    eds: EdsFile | None = None
    motor: Motor = Field(default_factory=Motor)
    registers: dict[PartName, HoldingRegister] = Field(default_factory=dict, alias="register")
    """The drive's registers by name."""
    frames: dict[PartName, CanFrame] = Field(default_factory=dict, alias="frame")
    """The drive's CAN frames by name."""
    reserved: dict[PartName, ReservedIds] = Field(default_factory=dict)
    """Identifiers that the drive sends or obeys beside its frames, by name."""
    signals: dict[PartName, CanSignal] = Field(default_factory=dict, alias="signal")
    """Values in CAN frames by name."""
    objects: dict[PartName, CanObject] = Field(default_factory=dict, alias="object")
    """Entries of a CANopen object dictionary by name."""
    channels: dict[ChannelNumber, MotorChannel] = Field(alias="channel")
    """The drive's motors, numbered 1, 2, ..."""
    steps: Sequences
    identity: list[IdentityRead] = Field(default_factory=list)
    """What is compared at each set-up."""
    enabled: EnabledWhen | None = None
    power_off: PowerOffWhen | None = None
    homed: HomedWhen | None = None
    watchdog: DriveWatchdog | None = None
    faults: list[FaultCode] = Field(default_factory=list, alias="fault")
    """The drive's faults."""
    bridge: MotorBridge | None = None
