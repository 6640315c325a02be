# SPDX-License-Identifier: Apache-2.0
"""Makes the drop-in that limits motord@ROBOT.service to the devices of one robot file.

Source: systemd.resource-control(5), DeviceAllow, with the names of device groups in /proc/devices.
"""

from __future__ import annotations

import re

from motord.config import Robot
from motord.config.sections.bus import JoystickInput
from motord.config.sections.joint.encoder import BoardEncoder, GpioEncoder, KernelEncoder
from motord.config.sections.line import CanLine, PwmLine, SerialLine

_ALWAYS = "/dev/cpu_dma_latency"
_GROUPS = re.compile(r"/dev/(ttyUSB|ttyACM|ttyAMA|ttyTHS|ttyS)\d+")
_PLUGGED = ("char-ttyUSB", "char-ttyACM")
"""Groups of an adapter that is named by its serial number or by a link of udev. It may belong to
either group."""


def drop_in(robot: Robot) -> str:
    """Return the text of the drop-in, for `systemctl edit`. It does not limit CPUs: each thread
    sets its own, by the robot file."""
    rows = ["[Service]", "DeviceAllow="]
    rows += [f"DeviceAllow={device} rw" for device in devices(robot)]
    if _writes_sysfs(robot):
        rows += ["# the files of PWM channels and counters; the rest of /sys stays read-only"]
        rows += ["ReadWritePaths=/sys/devices"]
    if _reads_joystick(robot):
        rows += ["# a joystick; the members of this group can read keyboards, too"]
        rows += ["SupplementaryGroups=input"]
    return "\n".join(rows) + "\n"


def devices(robot: Robot) -> list[str]:
    """Return the devices that the daemon opens, in the form of DeviceAllow."""
    found = [_ALWAYS]
    for line in robot.line.values():
        if isinstance(line, CanLine):
            found += _of_can(line)
        elif port := getattr(line, "port", None):
            found += _of_port(port)
    for joint in robot.joint.values():
        if isinstance(joint.encoder, BoardEncoder):
            found += _of_port(joint.encoder.port)
    if _uses_gpio(robot):
        found.append("char-gpiochip")
    if any(hasattr(part, "bus") for part in (robot.imu, robot.battery)):
        found.append("char-i2c")
    if _reads_joystick(robot):
        found.append("char-input")
    return list(dict.fromkeys(found))


def _of_port(port: str) -> tuple[str, ...]:
    group = _GROUPS.fullmatch(port)
    if group is not None:
        return (f"char-{group[1]}",)
    if port.startswith(("usb:", "/dev/serial/")):
        return _PLUGGED
    return (port,)


def _of_can(line: CanLine) -> tuple[str, ...]:
    """Return the devices of a CAN line; empty for a network interface, which is no device."""
    if line.interface in ("slcan", "robotell", "seeedstudio"):
        return _of_port(line.channel.partition("@")[0])
    return ("char-usb_device",) if line.interface == "canalystii" else ()


def _uses_gpio(robot: Robot) -> bool:
    lines = robot.line.values()
    turned = any(isinstance(one, SerialLine) and one.direction_gpio_chip for one in lines)
    pins = any(isinstance(one, PwmLine) and one.gpio_chip for one in lines)
    edges = any(isinstance(one.encoder, GpioEncoder) for one in robot.joint.values())
    return turned or pins or edges or bool(robot.safety.estop or robot.safety.watchdog)


def _reads_joystick(robot: Robot) -> bool:
    return any(isinstance(one, JoystickInput) for one in robot.input.values())


def _writes_sysfs(robot: Robot) -> bool:
    channels = any(isinstance(one, PwmLine) for one in robot.line.values())
    return channels or any(isinstance(j.encoder, KernelEncoder) for j in robot.joint.values())
