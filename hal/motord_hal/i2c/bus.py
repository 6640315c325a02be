# SPDX-License-Identifier: Apache-2.0
"""Registers of one device on an I2C bus: words of 16 bits, bytes, and rows of bytes.

Each access is one SMBus transfer, which the kernel keeps in one piece: other programs may use the
same bus, and other drivers other devices on it. Source: kernel, include/uapi/linux/i2c.h and
i2c-dev.h, Documentation/i2c/dev-interface.rst.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import struct
from pathlib import Path
from typing import Protocol, Self

from motord_hal.base.errors import BadReply, HalError, NoReply, PortError

_I2C_SLAVE = 0x0703
_I2C_SMBUS = 0x0720
_WRITE, _READ = 0, 1
_BYTE_DATA, _WORD_DATA, _I2C_BLOCK_DATA = 2, 3, 8
_BLOCK_BYTES = 34
"""Of union i2c_smbus_data."""
ROW_BYTES_MAX = 32
"""I2C_SMBUS_BLOCK_MAX."""
_REQUEST = struct.Struct("@BBIP")
"""struct i2c_smbus_ioctl_data: direction, register, kind, where the data is."""
_SILENT = (errno.ENXIO, errno.EREMOTEIO, errno.ETIMEDOUT, errno.EAGAIN)
"""No acknowledge, or a bus that somebody holds: Documentation/i2c/fault-codes.rst."""


class Registers(Protocol):
    """What a chip's driver needs of its bus. All raise HalError."""

    def read_word(self, register: int) -> int:
        """16 bits, the byte that comes first is the upper one."""
        ...

    def write_word(self, register: int, value: int) -> None: ...

    def read_row(self, register: int, size: int) -> bytes:
        """A register of so many bytes, the upper one first."""
        ...

    def close(self) -> None: ...


class ByteRegisters(Protocol):
    """As Registers, of a chip whose registers are bytes."""

    def read_byte(self, register: int) -> int: ...

    def write_byte(self, register: int, value: int) -> None: ...

    def read_row(self, register: int, size: int) -> bytes:
        """So many registers from this one on, in one transfer; at most ROW_BYTES_MAX."""
        ...

    def close(self) -> None: ...


class I2cDevice:
    """One address of a bus. Its calls block for as long as the transfer takes: some 0.4 ms, and 1 s
    and more where a device holds the bus."""

    def __init__(self, fd: int, where: str) -> None:
        self._fd = fd
        self._where = where

    @classmethod
    def open(cls, path: Path, address: int) -> Self:
        """Raises PortError."""
        where = f"{path} at 0x{address:02x}"
        try:
            fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise PortError(f"{where}: {_why(error)}") from error
        try:
            fcntl.ioctl(fd, _I2C_SLAVE, address)
        except OSError as error:
            os.close(fd)
            raise PortError(f"{where}: {_why(error)}") from error
        return cls(fd, where)

    def read_word(self, register: int) -> int:
        """As Registers. Raises NoReply, PortError, BadReply."""
        # SMBus sends the lower byte first, these chips the upper one
        return int.from_bytes(self._transfer(_READ, register, _WORD_DATA, b"")[:2], "big")

    def write_word(self, register: int, value: int) -> None:
        """As Registers. Raises NoReply, PortError, BadReply."""
        self._transfer(_WRITE, register, _WORD_DATA, value.to_bytes(2, "big"))

    def read_byte(self, register: int) -> int:
        """As ByteRegisters. Raises NoReply, PortError, BadReply."""
        return self._transfer(_READ, register, _BYTE_DATA, b"")[0]

    def write_byte(self, register: int, value: int) -> None:
        """As ByteRegisters. Raises NoReply, PortError, BadReply."""
        self._transfer(_WRITE, register, _BYTE_DATA, bytes((value,)))

    def read_row(self, register: int, size: int) -> bytes:
        """As ByteRegisters. Raises NoReply, PortError, BadReply."""
        found = self._transfer(_READ, register, _I2C_BLOCK_DATA, bytes((size,)))
        if found[0] != size:
            raise BadReply(f"{self._where}, register 0x{register:02x}: {found[0]} bytes of {size}")
        return found[1 : 1 + size]

    def close(self) -> None:
        """Once."""
        os.close(self._fd)

    def _transfer(self, direction: int, register: int, kind: int, value: bytes) -> bytes:
        data = ctypes.create_string_buffer(value, _BLOCK_BYTES)
        asked = _REQUEST.pack(direction, register, kind, ctypes.addressof(data))
        try:
            fcntl.ioctl(self._fd, _I2C_SMBUS, asked)
        except OSError as error:
            raise _error(f"{self._where}, register 0x{register:02x}", error) from error
        return data.raw


def _error(where: str, error: OSError) -> HalError:
    if error.errno in _SILENT:
        return NoReply(f"{where}: no answer ({error.strerror}): look at power, wires and address")
    if error.errno in (errno.ENODEV, errno.EBADF):
        return PortError(f"{where}: the bus is gone ({error.strerror})")
    return BadReply(f"{where}: {error.strerror}")


def _why(error: OSError) -> str:
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{error.strerror}: put this user into the group i2c"
    if error.errno == errno.ENOENT:
        return "there is no such bus: switch I2C on, load i2c-dev, or look at ls /dev/i2c-*"
    if error.errno == errno.EBUSY:
        return "a driver of the kernel has this device already: use its hwmon, or unbind it"
    return error.strerror or str(error)
