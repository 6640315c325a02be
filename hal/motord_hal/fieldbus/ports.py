# SPDX-License-Identifier: Apache-2.0
"""What a line is to the other packages: plain values in, plain values out, one protocol.

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
"""Set-points older than this do not count: the line stops and disarms its drives."""
REST_VELOCITY_RAD_S = 0.05
"""A wheel slower than this is at rest, unless the robot file sets another limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgesEncoder:
    """A quadrature encoder on two GPIO lines."""

    gpio_chip: str
    a: str
    """The line's name, or its number on the chip."""
    b: str
    pull: str
    """"none", "up" or "down"."""
    rad_per_count: float
    """Of the wheel, positive where it turns forward; a count is an edge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CounterEncoder:
    """A quadrature encoder on a counter of the kernel."""

    counter: str
    """Its name, part of its device's path, or counterN."""
    count: int
    """Which count of it."""
    rad_per_count: float
    """As in EdgesEncoder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardEncoder:
    """A quadrature encoder on your own board, which only counts."""

    port: str
    """Device file, or usb:SERIAL."""
    baudrate: int
    motor: int
    """Which one of the board, from 1 on."""
    rad_per_count: float
    """As in EdgesEncoder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSpec:
    """One wheel as its line sees it. `index` is the joint's place in the core's arrays."""

    index: int
    name: str
    profile: DriveProfile
    unit: int
    channel: int = 1
    cycle_hz: float | None = None
    """Wanted rate of this joint's drive; None: the line's."""
    gear_ratio: float = 1.0
    """Motor turns per wheel turn, > 0."""
    inverted: bool = False
    """True if the motor turns backward when the robot drives forward."""
    counts_per_turn: int = 0
    """Of the motor, of a joint that takes positions; 0: those of its profile."""
    zero_count: int = 0
    """The counter where the angle of such a joint is 0."""
    position_velocity_rad_s: float = 0.0
    """Its target moves no faster, > 0; of other joints 0."""
    pins: Mapping[str, str] = field(default_factory=dict)
    """Pin of the bridge → where it is: "pwmN", or a GPIO line's name or number; with "!" before it
    it is active low. "fault" is an input."""
    encoder: EdgesEncoder | CounterEncoder | BoardEncoder | None = None
    """Of a bridge's motor."""
    tries: int = 3
    reply_timeout_s: float | None = None
    """Deadline for a reply after the request's last byte; None: frame time plus the profile's
    turn-around."""


class DirectionKind(enum.StrEnum):
    """What switches an RS485 transceiver from receiving to sending and back."""

    AUTO = "auto"
    """The adapter itself: there is nothing to do."""
    KERNEL = "kernel"
    """The UART's driver, by RTS (kernel: Documentation/driver-api/serial/serial-rs485.rst)."""
    GPIO = "gpio"
    """The line's own thread, by a GPIO line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DirectionSpec:
    """How the transceiver is turned. The delays are between the edge and the first bit, and between
    the last bit and the edge back."""

    kind: DirectionKind = DirectionKind.AUTO
    active_high: bool = True
    """The level of RTS or of the GPIO line while sending."""
    before_s: float = 0.0
    after_s: float = 0.0
    gpio_chip: str = ""
    """GPIO: the chip's label or device file."""
    gpio_line: str = ""
    """GPIO: the line's name or its number on the chip."""


class Echo(enum.StrEnum):
    """Whether the adapter receives what it sends itself."""

    NO = "no"
    YES = "yes"
    AUTO = "auto"
    """The first read after opening decides."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PinsSpec:
    """Where the pins of a line of motor bridges are."""

    pwm_chip: str = ""
    """Part of the device path of the chip (its number changes from boot to boot), or pwmchipN."""
    gpio_chip: str = ""
    """The chip's label or device file."""
    pwm_hz: float | None = None
    """Carrier; None: that of each bridge's profile."""
    software_pwm: bool = False
    """Whether a chip is allowed whose pulses the kernel makes by timer interrupts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextWheel:
    """Where a wheel is: for boards that take the base's speed and turn rate."""

    side: float
    """-1 left, 1 right."""
    radius_m: float
    counts_per_turn: int = 0
    """Of the motor's shaft, into which a distance is converted; 0: there is no counter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextSpec:
    """Templates of a line of text: docs/mcu/line-ascii.md."""

    setpoints: str
    feedback: str = ""
    """Empty: the board sends nothing."""
    prefix: str = ""
    """Goes out as it is before the set-points, in every cycle."""
    feedback_scale: Mapping[str, float] = field(default_factory=dict)
    """Field → its number for 1 of the field's unit, where that is not 1."""
    scale: float = 1.0
    """The number of a joint is its set-point (motor rad/s, or duty of 1) times this."""
    wheels: Mapping[str, TextWheel]
    """By joint name."""
    track_m: float


@dataclass(frozen=True, slots=True)
class Mounting:
    """How an inertial sensor sits on the base: which of its axes (x, -x, y, -y, z or -z) points up,
    and which forward."""

    up: str = "z"
    forward: str = "x"

    def to_base(self, vector: Sequence[float]) -> tuple[float, ...]:
        """From the sensor's axes to the base's: x forward, y left (up × forward), z up."""
        return tuple(sign * vector[axis] for axis, sign in self._rows())

    def from_base(self, vector: Sequence[float]) -> tuple[float, ...]:
        """The inverse: what a sensor in this position reports."""
        sensed = [0.0, 0.0, 0.0]
        for (axis, sign), value in zip(self._rows(), vector, strict=True):
            sensed[axis] = sign * value
        return tuple(sensed)

    def _rows(self) -> tuple[tuple[int, float], ...]:
        """Of each of the base's axes: the sensor's that lies along it, and its sign."""
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
    """"modbus-rtu" and "ddsm" on a serial port; "modbus-tcp" and "rtu-over-tcp" through a
    gateway; "can"; "mcu", "ascii", "hoverboard" and "sabertooth" for a board alone on a port."""
    port: str
    """A device file, "usb:SERIAL" for the adapter with that serial number, HOST:PORT, or of a CAN
    bus INTERFACE:CHANNEL."""
    baudrate: int
    """Bits a second, of a CAN bus too."""
    parity: str
    """"none" | "even" | "odd"."""
    stop_bits: int
    cycle_hz: float
    """Requested cyclic rate; the line goes as fast as the wire allows, never faster than this."""
    gap_s: float | None
    """Silent interval between frames; None: by `gap`."""
    engine: str
    """"asyncio" | "rt" | "auto": rt where the line has a serial port or SocketCAN, else asyncio."""
    data_baudrate: int | None = None
    """Of the data of CAN FD frames; None: a CAN bus of classic frames."""
    gap: Gap | None = None
    """Rule for the silent interval; None: the longest that a drive of the line needs."""
    direction: DirectionSpec = DirectionSpec()
    echo: Echo = Echo.AUTO
    priority: int = 70
    """SCHED_FIFO priority of the line's thread (rt engine); 0: ordinary scheduling."""
    cpu: tuple[int, ...] = ()
    """CPUs of the line's thread (rt engine); none: all."""
    joints: tuple[JointSpec, ...]
    text: TextSpec | None = None
    """Of the kind "ascii"."""
    imu: Mounting | None = None
    """Of the sensor that the board reads for the core; None: there is no sensor."""
    fast_sync_read: bool = False
    """Of the kind "dynamixel": all servos answer in one packet while none of them fails."""
    pins: PinsSpec = PinsSpec()
    """Of the kind "pwm"."""
    watchdog_s: float
    """Wanted communication watchdog of the drives, written and read back where the profile has
    one."""
    setpoint_timeout_s: float = SETPOINT_TIMEOUT_S
    """The line stops its drives when the newest set-points are older than this."""
    rest_velocity_rad_s: float = REST_VELOCITY_RAD_S
    """A wheel slower than this is at rest: the power goes off at the end of a quick stop."""
    left_running: bool = False
    """Another program left the drives running: each begins with a quick stop."""


class LineState(enum.StrEnum):
    CLOSED = "closed"
    CONFIGURING = "configuring"
    READY = "ready"


class DriveState(enum.StrEnum):
    """A drive on a line. UNRESPONSIVE drives are probed with back-off and come back as READY, never
    as ARMED."""

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
    """Reported once, when something changes, not at each try. `text` is a sentence for the log."""

    kind: EventKind
    line: str
    joints: tuple[str, ...]
    text: str


@dataclass(slots=True)
class RoundTrips:
    """Round-trip times in microseconds: a bounded reservoir, newest kept."""

    p50_us: float = 0.0
    p99_us: float = 0.0
    max_us: float = 0.0


@dataclass(slots=True)
class LineStats:
    """Counters since start. `errors` is by kind: no_reply, bad_reply, refused, port."""

    exchanges: int = 0
    cycles: int = 0
    reopened: int = 0
    errors: dict[str, int] = field(default_factory=dict)
    cycle_hz: float = 0.0
    wire_limit_hz: float = 0.0
    """Highest cyclic rate that the wire can carry with these drives, frames and gaps."""
    round_trip: RoundTrips = field(default_factory=RoundTrips)


Listener = Callable[[LineEvent], None]


class Line(Protocol):
    """A medium with one runner. All requests go through the cycle of `run()`: one at a time."""

    spec: LineSpec

    @property
    def engine(self) -> str:
        """ "asyncio" or "rt": the engine that `spec.engine` chose."""
        ...

    @property
    def state(self) -> LineState: ...

    @property
    def drive_states(self) -> dict[str, DriveState]:
        """By joint name."""
        ...

    @property
    def drive_faults(self) -> dict[str, tuple[str, ...]]:
        """By joint name: the words for the fault bits that are set."""
        ...

    @property
    def trace(self) -> Trace | None:
        """None: nothing is exchanged (pins)."""
        ...

    def stats(self) -> LineStats: ...

    async def run(self) -> None:
        """Open, configure, exchange; reopen with back-off, disarmed; for ever. Does not raise for
        faults of drives or ports. On cancellation: stop and disarm every drive within a short
        deadline, close, re-raise."""
        ...

    async def arm(self) -> None:
        """Enable all drives at zero speed and check that they report it; on any failure all are
        disarmed again and the first HalError is raised. Deadline inside."""
        ...

    async def disarm(self) -> None:
        """Zero speed, power off, on every drive that answers; raises the first HalError after
        trying all."""
        ...

    async def clear_faults(self) -> None:
        """Run the profile's fault-clearing steps; raise DriveFault if a drive still reports one."""
        ...

    async def read_register(self, joint: str, register: str) -> float:
        """A register of the joint's drive by its profile's name, in SI, read now in acyclic slots.
        LookupError: no such joint or register; HalError: not read."""
        ...

    async def write_register(self, joint: str, register: str, value: float) -> float:
        """Write it (SI), read it back and return what is in force. ValueError: out of the
        register's range, or the register is one that the cycle or the steps of the profile write;
        LookupError and HalError as `read_register`."""
        ...
