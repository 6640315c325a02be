# SPDX-License-Identifier: Apache-2.0
"""The lines of a robot file: one class for each kind."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from motord.config.sections.section import Field, Section, number

Cpus = tuple[Annotated[int, Field(ge=0, le=63)], ...]


class Line(Section):
    """Settings that every line has."""

    baudrate: int = number("bits a second on the wire", 1200, 4_500_000, "1/s", 115200)
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: int = number("stop bits", 1, 2, "1", 1)
    engine: Literal["auto", "asyncio", "rt"] = "auto"
    """Engine of the cyclic exchange: a real-time thread (rt, serial ports only) or asyncio."""
    cycle_hz: float = number(
        "exchanges a second with every drive, if possible", 1, 1000, "Hz", 50.0
    )


class SerialLine(Line):
    """A line on a serial port of this machine."""

    port: str = Field(min_length=1)
    """Device file (/dev/serial/by-id/... names the same adapter after every start), or usb:SERIAL
    for the adapter with that serial number."""
    gap: Literal["spec", "3.5char"] | None = None
    """Rule for the silence between frames: spec is the standard's (Modbus over serial line V1.02,
    2.5.1.1), 3.5char keeps 3.5 characters at any baud rate; by default the drives' rule."""
    gap_s: float | None = number(
        "silence between frames; the drive's or the standard's where it is not given (Modbus over "
        "serial line V1.02, 2.5.1.1)",
        0,
        0.1,
        "s",
        None,
    )
    direction: Literal["auto", "kernel", "gpio"] = "auto"
    """How the transceiver is switched to sending: by the adapter itself, by the UART's driver
    (RTS), or by the line's thread with a GPIO line."""
    direction_active_high: bool = True
    """Whether RTS or the GPIO line is high while sending."""
    direction_before_s: float = number("from talking to the first bit", 0, 0.01, "s", 0.0)
    direction_after_s: float = number("from the last bit to listening", 0, 0.01, "s", 0.0)
    direction_gpio_chip: str | None = None
    """The GPIO chip's label or device file."""
    direction_gpio_line: str | None = None
    """The GPIO line's name, or its number on the chip."""
    echo: Literal["auto", "yes", "no"] = "auto"
    """Whether the adapter receives what it sends itself; auto: found out after opening."""
    priority: int = number(
        "SCHED_FIFO priority of the line's thread, below the loop's; 0: ordinary scheduling",
        0,
        98,
        "1",
        70,
    )
    cpu: Cpus = Field(default=(), strict=False)
    """CPUs the line's thread may run on, each 0 to 63; none: all of them."""

    @property
    def address(self) -> str:
        """The port, as in the robot file."""
        return self.port


class RtuLine(SerialLine):
    """One RS485 pair with Modbus RTU."""

    kind: Literal["modbus-rtu"]


class DdsmLine(SerialLine):
    """One RS485 pair with DDSM motors, which speak frames of ten bytes."""

    kind: Literal["ddsm"]


class FeetechLine(SerialLine):
    """Feetech bus servos of the STS, SMS and SCS series on a half-duplex adapter."""

    kind: Literal["feetech"]


class DynamixelLine(SerialLine):
    """Dynamixel servos that speak protocol 2.0, on a half-duplex adapter."""

    kind: Literal["dynamixel"]
    fast_sync_read: bool = False
    """Whether all servos answer a cycle's read in one packet, which saves most of the wire's time.
    Their firmware has to know instruction 0x8A; while one of them fails, each answers for
    itself."""


class GatewayLine(Line):
    """Drives behind a gateway in the network; baud rate, parity and stop bits are its port's."""

    host: str = Field(min_length=1, pattern=r"^[^\s/]+$")
    """The gateway's name or address."""
    tcp_port: int = number("TCP port", 1, 65535, "1", 502)

    @property
    def address(self) -> str:
        """The gateway as HOST:PORT."""
        return f"{self.host}:{self.tcp_port}"


class TcpLine(GatewayLine):
    """A gateway that speaks Modbus TCP."""

    kind: Literal["modbus-tcp"]


class RtuOverTcpLine(GatewayLine):
    """A serial server that passes Modbus RTU frames as they are."""

    kind: Literal["rtu-over-tcp"]


class CanLine(Section):
    """One CAN bus."""

    kind: Literal["can"]
    interface: str = Field(default="socketcan", pattern=r"^[a-z][a-z0-9_]*$")
    """The kind of adapter, as python-can names it: socketcan, slcan, kvaser, udp_multicast, ...; or
    unix, a socket that carries SocketCAN's frames."""
    channel: str = Field(min_length=1)
    """The bus: network interface (can0), serial port (/dev/ttyACM0), GROUP:PORT of UDP, or a
    path."""
    bitrate: int = number(
        "bits a second; on socketcan as the interface was set up", 10_000, 1_000_000, "1/s", 500_000
    )
    data_bitrate: int | None = number(
        "bits a second of the data of CAN FD frames; none: classic frames only",
        10_000,
        8_000_000,
        "1/s",
        None,
    )
    engine: Literal["auto", "asyncio", "rt"] = "auto"
    """Engine of the cyclic exchange; auto: rt on socketcan and unix, asyncio on other adapters."""
    cycle_hz: float = number("set-points a second for every drive", 1, 1000, "Hz", 100.0)
    priority: int = number(
        "SCHED_FIFO priority of the line's thread (rt), below the loop's; 0: ordinary scheduling",
        0,
        98,
        "1",
        70,
    )
    cpu: Cpus = Field(default=(), strict=False)
    """CPUs the line's thread may run on, each 0 to 63; none: all of them."""

    @property
    def address(self) -> str:
        """The bus as INTERFACE:CHANNEL."""
        return f"{self.interface}:{self.channel}"

    @property
    def baudrate(self) -> int:
        """The bit rate, by the name that it has on other lines."""
        return self.bitrate

    @property
    def parity(self) -> Literal["none"]:
        """Always none: a CAN bus has no parity."""
        return "none"

    @property
    def stop_bits(self) -> int:
        """Always 1, the least that other lines have."""
        return 1


class PortLine(Line):
    """One device alone on a serial port of this machine, without a transceiver to switch."""

    port: str = Field(min_length=1)
    """Device file (/dev/serial/by-id/... names the same board after every start), or usb:SERIAL
    for the board with that serial number."""

    @property
    def address(self) -> str:
        """The port, as in the robot file."""
        return self.port


class McuLine(PortLine):
    """Your own board (ESP32, Arduino, Pico) that speaks motord's frames."""

    kind: Literal["mcu"]


class RoboclawLine(PortLine):
    """RoboClaws in packet serial mode; several may share a port."""

    kind: Literal["roboclaw"]


class AsciiLine(PortLine):
    """A board that reads its set-points as text."""

    kind: Literal["ascii"]
    template: str = Field(default="{left},{right}\n", min_length=1)
    """Text of the set-points: a field for each joint, as {left:.2f} or {left:d}; {left_m_s} and
    the like for the speed of the wheel's rim; or {v} and {w} for the base's m/s and rad/s."""
    prefix: str = Field(default="", max_length=200)
    """Text that is sent unchanged before the set-points of every cycle. It switches feedback or a
    time-out of the board on, which the board forgets when it restarts."""
    feedback: str | None = None
    """Text of the board's feedback, as "{left_count},{right_count}" with fields JOINT_count,
    JOINT_rad_s, JOINT_m_s, JOINT_m, JOINT_current_a and voltage_v; a JSON object is read by the
    names of its members; none: the board sends nothing."""
    feedback_scale: dict[str, Annotated[float, Field(gt=0, le=1e9)]] = Field(default_factory=dict)
    """Number that the board sends for 1 of a field's unit, by field: voltage_v = 100 where 11.5 V
    are sent as 1150."""
    scale: float = number(
        "a joint's number for a set-point of 1 (motor rad/s, or full duty): 255 for duties to 255",
        1e-6,
        1e6,
        "1",
        1.0,
    )


class HoverboardLine(PortLine):
    """A hoverboard's main board with the FOC firmware."""

    kind: Literal["hoverboard"]


class SabertoothLine(PortLine):
    """A Sabertooth in packet serial mode."""

    kind: Literal["sabertooth"]
    baudrate: int = number("bits a second on the wire", 1200, 4_000_000, "1/s", 9600)


class PwmLine(Section):
    """Motor bridges on pins of this machine."""

    kind: Literal["pwm"]
    pwm_chip: str | None = None
    """Part of the device path of the PWM chip, as 1f00098000.pwm, or pwmchipN; see docs/pwm.md."""
    gpio_chip: str | None = None
    """Label of the GPIO chip, as pinctrl-rp1, or its device file."""
    software_pwm: bool = False
    """Whether a PWM chip will do whose pulses the kernel makes by timer interrupts (pwm-gpio)."""
    pwm_hz: float | None = number(
        "carrier frequency; if left out, that of each bridge's profile", 10, 1_000_000, "Hz", None
    )
    cycle_hz: float = number("writes a second at most", 10, 1000, "Hz", 200.0)
    engine: Literal["auto", "rt"] = "auto"
    """Engine of the line: always a real-time thread."""
    priority: int = number("SCHED_FIFO priority of its thread, below the loop's", 0, 98, "1", 70)
    cpu: Cpus = Field(default=(), strict=False)
    """CPUs the line's thread may run on, each 0 to 63; none: all of them."""
    baudrate: ClassVar[int] = 115200
    parity: ClassVar[str] = "none"
    stop_bits: ClassVar[int] = 1

    @property
    def address(self) -> str:
        """The PWM chip and the GPIO chip of its pins."""
        return f"{self.pwm_chip or ''} {self.gpio_chip or ''}".strip()


AnyLine = (
    RtuLine
    | DdsmLine
    | FeetechLine
    | DynamixelLine
    | TcpLine
    | RtuOverTcpLine
    | CanLine
    | McuLine
    | AsciiLine
    | RoboclawLine
    | HoverboardLine
    | SabertoothLine
    | PwmLine
)
LineSection = Annotated[AnyLine, Field(discriminator="kind")]
