# SPDX-License-Identifier: Apache-2.0
"""Opens a serial port: looked up each time, exclusive, raw, with its transceiver's direction set
and the adapter's latency removed."""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from dataclasses import dataclass

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import DirectionKind, LineSpec
from motord_hal.serial.direction import set_kernel_direction
from motord_hal.serial.latency import ask_low_latency, shorten_latency_timer
from motord_hal.serial.settings import busy, claim, set_raw
from motord_hal.serial.sysfs import device_file, holders


class SettingRefused(PortError):
    """The port exists, but does not take this baud rate, parity or these stop bits."""


@dataclass(slots=True)
class OpenPort:
    """An open port. This object owns the descriptors."""

    fd: int
    de_fd: int = -1
    """Descriptor of the GPIO line that turns the transceiver; -1: no line."""
    path: str = ""
    """Path of the device file that was found."""
    facts: tuple[str, ...] = ()
    """Facts on this port for the user, in sentences."""

    def flush(self) -> None:
        """Drop bytes that have come or wait to be sent. Raises PortError."""
        try:
            termios.tcflush(self.fd, termios.TCIOFLUSH)
        except termios.error as error:
            raise PortError(f"{self.path} went away: {error}") from error

    def close(self) -> None:
        os.close(self.fd)
        if self.de_fd >= 0:
            os.close(self.de_fd)


def open_port(spec: LineSpec) -> OpenPort:
    """Open the port of a line. An adapter is found again under another name. Raises PortError."""
    path = device_file(spec.port)
    fd = open_exclusively(path)
    with contextlib.ExitStack() as undo:
        undo.callback(os.close, fd)
        try:
            set_raw(fd, spec.baudrate, spec.parity, spec.stop_bits)
        except (OSError, ValueError, termios.error) as error:
            wanted = f"{spec.baudrate} baud, parity {spec.parity}, {spec.stop_bits} stop bits"
            raise SettingRefused(f"{path} cannot be set to {wanted}: {error}") from error
        facts = tune(fd, path, spec)
        de_fd = -1
        if spec.direction.kind is DirectionKind.GPIO:
            # imported only here: other lines need no libgpiod
            from motord_hal.serial.gpio import request_line

            de_fd = request_line(spec.direction, spec.name)
        undo.pop_all()
    return OpenPort(fd, de_fd, path, facts)


def tune(fd: int, path: str, spec: LineSpec) -> tuple[str, ...]:
    """Set what termios does not cover: the kernel's direction and the adapter's latency. Return
    facts for the user. Raises PortError."""
    if spec.direction.kind is DirectionKind.KERNEL:
        set_kernel_direction(fd, path, spec.direction)
    ask_low_latency(fd)
    fact = shorten_latency_timer(path)
    return (fact,) if fact else ()


def open_exclusively(path: str) -> int:
    """Return a non-blocking descriptor of a port that no other program has. Raises PortError."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise PortError(f"{path} cannot be opened: {reason(path, error)}") from error
    try:
        claim(fd)
    except OSError as error:
        os.close(fd)
        raise PortError(f"{path} cannot be opened: {reason(path, error)}") from error
    return fd


def reason(path: str, error: OSError) -> str:
    """Return why a port cannot be opened, and what to do."""
    if busy(error):
        return (
            f"another program has it open: {', '.join(holders(path)) or 'not visible to this user'}"
        )
    if isinstance(error, PermissionError):
        return (
            "this user may not use it: run this with sudo, or sudo usermod -aG dialout $USER and "
            "log in again"
        )
    if isinstance(error, FileNotFoundError):
        # imported only here: lines of pins or boards need no pyserial
        from serial.tools.list_ports import comports

        found = sorted({port.device for port in comports()})
        return f"there is no such port (ports here: {', '.join(found) or 'none'})"
    if error.errno in (errno.ENOTTY, errno.EINVAL):
        return "it is no serial port"
    return error.strerror or str(error)
