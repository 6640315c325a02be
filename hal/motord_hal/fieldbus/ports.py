# SPDX-License-Identifier: Apache-2.0
"""The interface of a line for other packages: the protocol `Line`, and plain values.

A line is one shared medium (an RS485 pair, a CAN bus). The daemon builds a LineSpec from the robot
file, `open_line` (motord_hal.fieldbus.open_line) turns it into a Line, and `Line.run()` does the
rest until it is cancelled.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from motord_hal.drives.profile import DriveProfile, Gap
from motord_hal.fieldbus.trace import Trace

SETPOINT_TIMEOUT_S = 0.1
"""Age at which set-points are too old: the line then stops and disarms its drives."""
REST_VELOCITY_RAD_S = 0.05
"""A wheel slower than this is at rest, unless the robot file sets another limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgesEncoder:
    """A quadrature encoder on two GPIO lines."""

    gpio_chip: str
    a: str
    """Name of the GPIO line of signal A, or its number on the chip; `b` likewise for signal B."""
    b: str
    pull: str
    """Pull resistor of both lines: "none", "up" or "down"."""
    rad_per_count: float
    """Angle of the wheel for one count (one edge); positive if turning forward counts up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CounterEncoder:
    """A quadrature encoder on a counter of the kernel."""

    counter: str
    """The counter's name, a part of its device's path, or counterN."""
    count: int
    """Number of the count on this counter (the N of the kernel's `countN`)."""
    rad_per_count: float
    """See `EdgesEncoder.rad_per_count`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardEncoder:
    """A quadrature encoder on your own board, which only counts."""

    port: str
    """Device file, or usb:SERIAL."""
    baudrate: int
    motor: int
    """Number of the motor on the board, from 1 on."""
    rad_per_count: float
    """See `EdgesEncoder.rad_per_count`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSpec:
    """The data of one joint for its line. `index` is the joint's place in the core's arrays."""

    index: int
    name: str
    profile: DriveProfile
    unit: int
    channel: int = 1
    cycle_hz: float | None = None
    """Requested cyclic rate of this joint's drive; None: the rate of the line."""
    gear_ratio: float = 1.0
    """Motor turns per wheel turn, > 0."""
    inverted: bool = False
    """True if the motor turns backward when the robot drives forward."""
    counts_per_turn: int = 0
    """Counts for one turn of the motor, if the joint takes positions; 0: as in the profile."""
    zero_count: int = 0
    """Value of the position counter at the angle 0 of a joint that takes positions."""
    position_min_rad: float = 0.0
    position_max_rad: float = 0.0
    """Range of a joint that takes positions."""
    position_velocity_rad_s: float = 0.0
    """Highest speed of the target of a joint that takes positions, > 0; 0 for other joints."""
    identity: Mapping[str, int] = field(default_factory=dict)
    """Register of the drive → raw value that it has to read at each set-up. It replaces what the
    profile expects there."""
    pins: Mapping[str, str] = field(default_factory=dict)
    """Pin of the bridge → its place: "pwmN", or the name or number of a GPIO line; a "!" before it
    means active low. "fault" is an input."""
    encoder: EdgesEncoder | CounterEncoder | BoardEncoder | None = None
    """Encoder of a motor on a bridge."""
    tries: int = 3
    reply_timeout_s: float | None = None
    """Deadline for a reply after the request's last byte; None: frame time plus the profile's
    turn-around."""

    # What has a sign, and is turned at an inverted joint: set-points by `sign`; velocity and
    # current by the two factors; the frames of a `direction` by `inverted`; the counter in the
    # core, by `rad_per_count` of the configuration. Voltage, temperature and fault word have none.
    @property
    def sign(self) -> float:
        """-1 if the motor turns backward when the robot drives forward, else 1."""
        return -1.0 if self.inverted else 1.0

    @property
    def velocity_factor(self) -> float:
        """Factor from the motor's velocity to the wheel's."""
        return self.sign / self.gear_ratio

    @property
    def current_factor(self) -> float:
        """Factor from the reported current to that of the joint, which is positive while the wheel
        is pushed forward; a current without a sign, or by power, stays as it is."""
        channel = self.profile.channels[self.channel]
        if channel.current is None or channel.current_sign != "torque":
            return 1.0
        return self.sign if self.profile.registers[channel.current].type.signed else 1.0


class DirectionKind(enum.StrEnum):
    """The part that switches an RS485 transceiver from receiving to sending and back."""

    AUTO = "auto"
    """The adapter switches by itself: motord does nothing."""
    KERNEL = "kernel"
    """The UART's driver switches by RTS (Documentation/driver-api/serial/serial-rs485.rst)."""
    GPIO = "gpio"
    """The line's own thread switches by a GPIO line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionSpec:
    """How the direction of the transceiver is switched. `before_s` is from the edge to the first
    bit, `after_s` from the last bit to the edge back."""

    kind: DirectionKind = DirectionKind.AUTO
    active_high: bool = True
    """The level of RTS or of the GPIO line while sending."""
    before_s: float = 0.0
    after_s: float = 0.0
    gpio_chip: str = ""
    """For GPIO: label or device file of the chip."""
    gpio_line: str = ""
    """For GPIO: name of the line, or its number on the chip."""


class Echo(enum.StrEnum):
    """Whether the adapter receives what it sends itself."""

    NO = "no"
    YES = "yes"
    AUTO = "auto"
    """The line finds out with the first read after it was opened."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PinsSpec:
    """The chips and the carrier of the pins of a line of motor bridges."""

    pwm_chip: str = ""
    """Part of the device path of the chip (its number changes from boot to boot), or pwmchipN."""
    gpio_chip: str = ""
    """The chip's label or device file."""
    pwm_hz: float | None = None
    """Carrier frequency; None: the one in the profile of each bridge."""
    software_pwm: bool = False
    """Whether to accept a chip whose pulses the kernel makes by timer interrupts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextWheel:
    """Geometry of a wheel, for boards that take the base's speed and turn rate."""

    side: float
    """Side of the base on which the wheel is: -1 left, 1 right."""
    radius_m: float
    counts_per_turn: int = 0
    """Counts for one turn of the motor's shaft, to convert distances; 0: there is no counter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextSpec:
    """Templates of the lines of text to and from a board (docs/mcu/line-ascii.md)."""

    setpoints: str
    feedback: str = ""
    """Template of the feedback; empty: the board sends nothing."""
    prefix: str = ""
    """Text that is sent unchanged before the set-points, in every cycle."""
    feedback_scale: Mapping[str, float] = field(default_factory=dict)
    """Field → the number in the text that means 1 of the field's unit, if it is not 1."""
    scale: float = 1.0
    """Factor from a joint's set-point (motor rad/s, or duty of 1) to its number in the text."""
    wheels: Mapping[str, TextWheel]
    """Joint name → wheel."""
    track_m: float


@dataclass(frozen=True, slots=True)
class Mounting:
    """How an inertial sensor is mounted on the base: the axis of the sensor (x, -x, y, -y, z or -z)
    that points up, and the one that points forward."""

    up: str = "z"
    forward: str = "x"

    def to_base(self, vector: Sequence[float]) -> tuple[float, ...]:
        """Convert from the sensor's axes to the base's: x forward, y left (up × forward), z up."""
        return tuple(sign * vector[axis] for axis, sign in self._rows())

    def from_base(self, vector: Sequence[float]) -> tuple[float, ...]:
        """Convert from the base's axes to what a sensor in this mounting reports."""
        sensed = [0.0, 0.0, 0.0]
        for (axis, sign), value in zip(self._rows(), vector, strict=True):
            sensed[axis] = sign * value
        return tuple(sensed)

    def _rows(self) -> tuple[tuple[int, float], ...]:
        """Return for each axis of the base the axis of the sensor along it, and its sign."""
        (f, forward_sign), (u, up_sign) = _axis(self.forward), _axis(self.up)
        even = (f - u) % 3 == 1
        left_sign = forward_sign * up_sign * (1.0 if even else -1.0)
        return (f, forward_sign), (3 - f - u, left_sign), (u, up_sign)


def _axis(name: str) -> tuple[int, float]:
    return "xyz".index(name[-1]), -1.0 if name.startswith("-") else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSpec:
    """One medium and the joints on it. `index` is the line's place in the exchange."""

    index: int
    name: str
    kind: str
    """"modbus-rtu", "ddsm", "roboclaw", "feetech", "dynamixel" on a serial port; "modbus-tcp" and
    "rtu-over-tcp" through a gateway; "can"; "pwm"; "mcu", "ascii", "hoverboard" and "sabertooth"
    for a board alone on a port."""
    port: str
    """A device file, "usb:SERIAL" for the adapter with that serial number, HOST:PORT, or
    INTERFACE:CHANNEL for a CAN bus."""
    baudrate: int
    """Bits a second, for a CAN bus too."""
    parity: str
    """"none", "even" or "odd"."""
    stop_bits: int
    cycle_hz: float
    """Requested cyclic rate. The line runs slower if the wire cannot carry it, never faster."""
    gap_s: float | None
    """Silent interval between frames; None: as `gap` demands."""
    engine: str
    """"asyncio", "rt" or "auto": rt if the line has a serial port or SocketCAN, else asyncio."""
    data_baudrate: int | None = None
    """Bits a second in the data of CAN FD frames; None: the CAN bus has classic frames only."""
    gap: Gap | None = None
    """Rule for the silent interval; None: the longest interval that a drive of the line needs."""
    direction: DirectionSpec = DirectionSpec()
    echo: Echo = Echo.AUTO
    priority: int = 70
    """SCHED_FIFO priority of the line's thread (rt engine); 0: ordinary scheduling."""
    cpu: tuple[int, ...] = ()
    """CPUs of the line's thread (rt engine); empty: all."""
    joints: tuple[JointSpec, ...]
    text: TextSpec | None = None
    """Templates of the text of a line of kind "ascii"."""
    imu: Mounting | None = None
    """Mounting of the sensor that the board reads for the core; None: there is no sensor."""
    fast_sync_read: bool = False
    """For the kind "dynamixel": all servos answer in one packet while none of them fails."""
    pins: PinsSpec = PinsSpec()
    """Pins of a line of kind "pwm"."""
    watchdog_s: float
    """Requested time of the drives' communication watchdog. It is written and read back if the
    profile has a watchdog."""
    setpoint_timeout_s: float = SETPOINT_TIMEOUT_S
    """The line stops its drives when the newest set-points are older than this."""
    rest_velocity_rad_s: float = REST_VELOCITY_RAD_S
    """A wheel slower than this is at rest; a quick stop then ends, and the power goes off."""
    left_running: bool = False
    """True if another program left the drives running: each then begins with a quick stop."""


class LineState(enum.StrEnum):
    CLOSED = "closed"
    CONFIGURING = "configuring"
    READY = "ready"


class DriveState(enum.StrEnum):
    """State of a drive on a line. An UNRESPONSIVE drive is polled with back-off; it comes back as
    READY, never as ARMED."""

    UNKNOWN = "unknown"
    READY = "ready"
    ARMED = "armed"
    UNRESPONSIVE = "unresponsive"


class EventKind(enum.StrEnum):
    LINE_OPEN = "line_open"
    LINE_LOST = "line_lost"
    DRIVE_READY = "drive_ready"
    DRIVE_UNRESPONSIVE = "drive_unresponsive"
    DRIVE_BACK = "drive_back"
    DRIVE_FAULT = "drive_fault"
    DRIVE_FAULT_GONE = "drive_fault_gone"
    DRIVE_WARNING = "drive_warning"
    DRIVE_LEFT_ON = "drive_left_on"
    """The line was closed, and the drive has not acknowledged its power-off."""


@dataclass(frozen=True, slots=True)
class LineEvent:
    """An event of a line, reported once, when something changes, not at each try. `text` is a
    sentence for the log."""

    kind: EventKind
    line: str
    joints: tuple[str, ...]
    text: str


@dataclass(slots=True)
class RoundTrips:
    """Percentiles and maximum of the round-trip times, in microseconds."""

    p50_us: float = 0.0
    p99_us: float = 0.0
    max_us: float = 0.0


@dataclass(slots=True)
class LineStats:
    """Line counters since the start. Keys of `errors`: no_reply, bad_reply, refused, port."""

    exchanges: int = 0
    cycles: int = 0
    reopened: int = 0
    errors: dict[str, int] = field(default_factory=dict)
    cycle_hz: float = 0.0
    """Cyclic rate, smoothed; 0: none is known. Where drives have rates of their own, it is that of
    the drive which falls behind its rate most."""
    requested_hz: float = 0.0
    """The rate that the robot file requests of the line, or of that drive."""
    wire_limit_hz: float = 0.0
    """Highest cyclic rate that the wire can carry with these drives, frames and gaps, if the drives
    answer at once."""
    round_trip: RoundTrips = field(default_factory=RoundTrips)


Listener = Callable[[LineEvent], None]


class Line(Protocol):
    """A line, run by one task. All requests go through the cycle of `run()`, one at a time."""

    spec: LineSpec

    @property
    def engine(self) -> str:
        """The engine in use, "asyncio" or "rt", as `spec.engine` selects it."""
        ...

    @property
    def state(self) -> LineState: ...

    @property
    def drive_states(self) -> dict[str, DriveState]:
        """Joint name → state of its drive."""
        ...

    @property
    def drive_faults(self) -> dict[str, tuple[str, ...]]:
        """Joint name → texts of the faults that the drive reports."""
        ...

    @property
    def trace(self) -> Trace | None:
        """The line's trace; None for a line of pins, which exchanges no bytes."""
        ...

    def stats(self) -> LineStats: ...

    async def run(self) -> None:
        """Open the medium, configure the drives and exchange data until cancelled. When the medium
        is lost, reopen it with back-off, disarmed; faults of drives or ports raise nothing. On
        cancellation stop and disarm every drive within a short deadline, close, re-raise."""
        ...

    async def arm(self) -> None:
        """Enable all drives at zero speed and check that they report it, with a deadline. On any
        failure disarm all of them again and raise the first HalError."""
        ...

    async def disarm(self) -> None:
        """Send zero speed and power-off to every drive that answers. Raise the first HalError after
        all were tried; NoReply if a drive does not answer."""
        ...

    async def clear_faults(self) -> None:
        """Run the profile's fault-clearing steps; raise DriveFault if a drive still reports one."""
        ...

    async def read_register(self, joint: str, register: str) -> float:
        """Read a register of the joint's drive outside the cycle; return its value in SI.
        `register` is its name in the profile. LookupError: no such joint or register; HalError: not
        read."""
        ...

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """Write a value in SI to a register, read it back and return the value in force.
        ValueError: the value is out of range, or the cycle or the steps of the profile write this
        register; LookupError and HalError as in `read_register`."""
        ...
