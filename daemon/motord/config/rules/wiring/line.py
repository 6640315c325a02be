# SPDX-License-Identifier: Apache-2.0
"""Rules between the keys of a line: which engine, which port, which transceiver."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.sections.line import (
    AnyLine,
    AsciiLine,
    CanLine,
    DdsmLine,
    DynamixelLine,
    FeetechLine,
    GatewayLine,
    HoverboardLine,
    McuLine,
    PortLine,
    PwmLine,
    SabertoothLine,
    SerialLine,
)
from motord.config.sections.model import Robot
from motord.config.toml_lines import Path
from motord_hal.ascii.dialect import (
    COUNT,
    RIM_DISTANCE,
    check_feedback,
    check_setpoints,
    feedback_fields,
    setpoint_fields,
    why_not_possible,
)
from motord_hal.ascii.text import Text
from motord_hal.ascii.twist import ANGULAR, LINEAR
from motord_hal.can.adapters import why_unfit
from motord_hal.fieldbus.open_line import RT_CAN_INTERFACES
from motord_hal.sabertooth.codec import UNITS as SABERTOOTH_UNITS
from motord_hal.serial.sysfs import port_identity

ON_RT_ONLY = (DdsmLine, DynamixelLine, FeetechLine, PortLine)
"""Kinds that are always on a serial port of this machine."""
WITHOUT_ADDRESS = (McuLine, AsciiLine, HoverboardLine)
_DEVICE = re.compile(r"(tty[A-Z]\w*|serial\d|rfcomm\d+)")
"""Names in /dev of serial ports: drivers' prefixes, the Raspberry Pi's links, Bluetooth."""
_WINDOWS = re.compile(r"COM\d+", re.IGNORECASE)


def _one_port_a_line(robot: Robot) -> Iterator[Finding]:
    for (one, first), (other, second) in itertools.combinations(robot.line.items(), 2):
        if _port(first) == _port(second):
            paths = (("line", other, _port_key(second)), ("line", one, _port_key(first)))
            yield Finding(paths, f'line "{one}" has this port already')


def _port_name(robot: Robot) -> Iterator[Finding]:
    """Refuse names of ports that are no paths: `open` looks for them in the present folder."""
    for name, line in robot.line.items():
        if isinstance(line, GatewayLine | PwmLine):
            continue
        port = line.channel if isinstance(line, CanLine) else line.port
        at = (("line", name, _port_key(line)),)
        if _DEVICE.fullmatch(port):
            yield Finding(at, f'"{port}" is no path: write "/dev/{port}"')
        elif _WINDOWS.fullmatch(port):
            text = f'"{port}" is a port of Windows: here it is "/dev/ttyUSB0" or "/dev/ttyACM0"'
            yield Finding(at, f"{text}, for instance (`ls -l /dev/serial/by-id` shows them)")


def _port(line: AnyLine) -> str:
    """Return what the line's port is on this machine: a device has more names than one, and lines
    of different protocols may name it."""
    if isinstance(line, GatewayLine | PwmLine):
        return line.address
    name = line.channel if isinstance(line, CanLine) else line.port
    return port_identity(name if name.startswith("/") else line.address)


def _port_key(line: AnyLine) -> str:
    if isinstance(line, CanLine):
        return "channel"
    return "tcp_port" if isinstance(line, GatewayLine) else "port"


def _engine(robot: Robot) -> Iterator[Finding]:
    for name, line in robot.line.items():
        at = (("line", name, "engine"), ("line", name, "kind"))
        if isinstance(line, GatewayLine) and line.engine == "rt":
            text = f'"rt" needs a serial port: kind "{line.kind}" runs on "asyncio"'
            yield Finding(at, text)
        elif isinstance(line, CanLine) and line.engine == "rt":
            if line.interface not in RT_CAN_INTERFACES:
                paths = (("line", name, "engine"), ("line", name, "interface"))
                text = f'"rt" needs SocketCAN: interface "{line.interface}" runs on "asyncio"'
                yield Finding(paths, text)
        elif isinstance(line, ON_RT_ONLY) and line.engine == "asyncio":
            yield Finding(at, f'kind "{line.kind}" runs on "rt": remove "engine", or write "auto"')


def _adapter(robot: Robot) -> Iterator[Finding]:
    for name, line in robot.line.items():
        if isinstance(line, CanLine):
            problem = why_unfit(line.interface, fd_frames=line.data_bitrate is not None)
            if problem:
                paths = (("line", name, "interface"), ("line", name, "data_bitrate"))
                yield Finding(paths, problem)


def _unit(robot: Robot) -> Iterator[Finding]:
    """Check that every drive has its address; a board is alone on its line and needs no address."""
    for name, joint in robot.joint.items():
        line = robot.line.get(joint.line)
        if isinstance(line, SabertoothLine) and joint.unit not in SABERTOOTH_UNITS:
            text = f"{joint.unit} is not an address of a Sabertooth (128 to 135)"
            yield Finding((("joint", name, "unit"), ("line", joint.line, "kind")), text)
            continue
        if "unit" in joint.model_fields_set or line is None or isinstance(line, WITHOUT_ADDRESS):
            continue
        text = "is missing: the address of its drive on this line"
        yield Finding((("joint", name, "unit"), ("joint", name, "line")), f"{text} (0 to 255)")


def _one_board(robot: Robot) -> Iterator[Finding]:
    for (one, first), (other, second) in itertools.combinations(robot.joint.items(), 2):
        alone = isinstance(robot.line.get(first.line), WITHOUT_ADDRESS)
        if alone and first.line == second.line and first.unit != second.unit:
            text = f'line "{first.line}" has one board: joint {one} is on unit {first.unit}'
            kind: Path = ("line", first.line, "kind")
            yield Finding((("joint", other, "unit"), ("joint", one, "unit"), kind), text)


def _one_profile(robot: Robot) -> Iterator[Finding]:
    """Check that all Sabertooths of a line have one profile: they move and stop as one drive."""
    for (one, first), (other, second) in itertools.combinations(robot.joint.items(), 2):
        together = isinstance(robot.line.get(first.line), SabertoothLine)
        if together and first.line == second.line and first.drive != second.drive:
            text = f'joint {one} on the same wire has "{first.drive}": all Sabertooths take one'
            yield Finding((("joint", other, "drive"), ("joint", one, "drive")), text)


def _templates(robot: Robot) -> Iterator[Finding]:
    for name, line in robot.line.items():
        if not isinstance(line, AsciiLine):
            continue
        joints = tuple(joint for joint, section in robot.joint.items() if section.line == name)
        template = (("line", name, "template"), ("line", name, "kind"))
        text: Text | None
        try:
            text = Text(line.template, setpoint_fields(joints))
            check_setpoints(text, joints)
            yield from _twist(robot, joints, text, template)
        except ValueError as error:
            text = None
            yield Finding(template, str(error))
        try:
            received = Text(line.feedback, feedback_fields(joints)) if line.feedback else None
            if received is not None:
                check_feedback(received, joints, line.feedback_scale)
        except ValueError as error:
            yield Finding((("line", name, "feedback"), ("line", name, "kind")), str(error))
            continue
        yield from _counts(robot, joints, received.fields if received else ())
        if text is not None:
            yield from _text_formats(name, text, received)


def _text_formats(name: str, sent: Text, received: Text | None) -> Iterator[Finding]:
    if why := why_not_possible(sent, received):
        yield Finding((("line", name, "template"), ("line", name, "feedback")), why)


def _twist(
    robot: Robot, joints: tuple[str, ...], text: Text, at: tuple[Path, ...]
) -> Iterator[Finding]:
    sides = {robot.joint[joint].side for joint in joints if not robot.base.strafes}
    if set(text.fields) == {LINEAR, ANGULAR} and sides != {"left", "right"}:
        yield Finding(at, "v and w need a left and a right joint on this line")


def _counts(robot: Robot, joints: tuple[str, ...], received: tuple[str, ...]) -> Iterator[Finding]:
    for joint in joints:
        line = robot.joint[joint].line
        at: tuple[Path, ...] = (
            ("joint", joint, "counts_per_turn"),
            ("joint", joint, "line"),
            ("line", line, "kind"),
        )
        counts = {joint + COUNT, joint + RIM_DISTANCE} & set(received)
        sent, given = bool(counts), robot.joint[joint].counts_per_turn
        if sent and not given:
            yield Finding(at, "is missing: the board reports a count, or a distance")
        elif not sent and given:
            text = f"is not used: the line's feedback has no {{{joint}{COUNT}}}"
            yield Finding(at, f"{text}; add it there, or leave this key out")


def _gap(robot: Robot) -> Iterator[Finding]:
    for name, line in robot.line.items():
        if isinstance(line, SerialLine) and line.gap is not None and line.gap_s is not None:
            paths = (("line", name, "gap_s"), ("line", name, "gap"))
            yield Finding(paths, "the silence is given twice: by gap and by gap_s")


def _direction(robot: Robot) -> Iterator[Finding]:
    for name, line in robot.line.items():
        if not isinstance(line, SerialLine):
            continue
        direction = ("line", name, "direction")
        if line.direction == "gpio" and line.engine == "asyncio":
            text = '"gpio" needs engine "rt": the line is switched by its real-time thread'
            yield Finding((direction, ("line", name, "engine")), text)
        for key in ("direction_gpio_chip", "direction_gpio_line"):
            path = ("line", name, key)
            if line.direction == "gpio" and not getattr(line, key):
                yield Finding((path, direction), 'is missing: direction = "gpio" needs it')
            elif line.direction != "gpio" and key in line.model_fields_set:
                yield Finding((path, direction), 'is only for direction = "gpio"')
        for key in ("direction_active_high", "direction_before_s", "direction_after_s"):
            if line.direction == "auto" and key in line.model_fields_set:
                text = 'is only for direction = "kernel" and "gpio"'
                yield Finding((("line", name, key), direction), text)


def _priority(robot: Robot) -> Iterator[Finding]:
    loop = robot.loop.priority
    for name, line in robot.line.items():
        if not isinstance(line, SerialLine | CanLine):
            continue
        if "priority" in line.model_fields_set and 0 < loop <= line.priority:
            text = f"{line.priority} is not below the loop's ({loop})"
            yield Finding((("line", name, "priority"), ("loop", "priority")), text)


LINE_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _one_port_a_line,
    _port_name,
    _engine,
    _adapter,
    _unit,
    _one_board,
    _one_profile,
    _templates,
    _gap,
    _direction,
    _priority,
)
