# SPDX-License-Identifier: Apache-2.0
"""Registers of one device on an I2C bus: words of 16 bits, bytes, and rows of bytes.

Each access is one SMBus transfer, which the kernel keeps in one piece: other programs may use the
same I2C bus, and other drivers may use other devices on it.
"""

from __future__ import annotations

import errno
import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self, cast

from motord_hal.base.errors import BadReply, HalError, NoReply, PortError

if TYPE_CHECKING:
    from smbus2 import SMBus

_I2C_SLAVE = 0x0703
"""Request to set the device's address, from linux/i2c-dev.h."""
_SILENT = (errno.ENXIO, errno.EREMOTEIO, errno.ETIMEDOUT, errno.EAGAIN)
"""Errors of a device that does not acknowledge, or of an I2C bus that is held:
Documentation/i2c/fault-codes.rst."""


class Registers(Protocol):
    """Register access on an I2C bus, for a chip's driver. All methods raise HalError."""

    def read_word(self, register: int) -> int:
        """Read 16 bits; the first byte is the upper one."""
        ...

    def write_word(self, register: int, value: int) -> None: ...

    def read_row(self, register: int, size: int) -> bytes:
        """Read a register of `size` bytes, the upper one first."""
        ...

    def close(self) -> None: ...


class ByteRegisters(Protocol):
    """Register access like `Registers`, for a chip whose registers are bytes."""

    def read_byte(self, register: int) -> int: ...

    def write_byte(self, register: int, value: int) -> None: ...

    def read_row(self, register: int, size: int) -> bytes:
        """Read `size` registers from this one on in one transfer; at most 32
        (I2C_SMBUS_BLOCK_MAX)."""
        ...

    def close(self) -> None: ...


class I2cDevice:
    """One address on an I2C bus. A call blocks for as long as the transfer takes: some 0.4 ms, and
    1 s and more if a device holds the I2C bus."""

    def __init__(self, bus: SMBus, address: int, where: str) -> None:
        self._bus = bus
        self._address = address
        self._where = where

    @classmethod
    def open(cls, path: Path, address: int) -> Self:
        """Open the bus. Raises PortError."""
        from smbus2 import SMBus  # imported only here: most robots have no I2C bus

        where = f"{path} at 0x{address:02x}"
        try:
            bus = SMBus(str(path))
        except OSError as error:
            raise PortError(f"{where}: {_why(error)}") from error
        return cls(bus, address, where)

    def read_word(self, register: int) -> int:
        """Implement `Registers.read_word`. Raises NoReply, PortError, BadReply."""
        with self._transfer(register):
            return _swapped(self._bus.read_word_data(self._address, register))

    def write_word(self, register: int, value: int) -> None:
        """Implement `Registers.write_word`. Raises NoReply, PortError, BadReply."""
        with self._transfer(register):
            self._bus.write_word_data(self._address, register, _swapped(value))

    def read_byte(self, register: int) -> int:
        """Implement `ByteRegisters.read_byte`. Raises NoReply, PortError, BadReply."""
        with self._transfer(register):
            return self._bus.read_byte_data(self._address, register)

    def write_byte(self, register: int, value: int) -> None:
        """Implement `ByteRegisters.write_byte`. Raises NoReply, PortError, BadReply."""
        with self._transfer(register):
            self._bus.write_byte_data(self._address, register, value)

    def read_row(self, register: int, size: int) -> bytes:
        """Implement `ByteRegisters.read_row`. Raises NoReply, PortError, BadReply."""
        from smbus2.smbus2 import (
            I2C_SMBUS,
            I2C_SMBUS_I2C_BLOCK_DATA,
            I2C_SMBUS_READ,
            i2c_smbus_ioctl_data,
        )

        # not read_i2c_block_data: it returns zeros for what an adapter has not filled
        message = i2c_smbus_ioctl_data.create(
            read_write=I2C_SMBUS_READ, command=register, size=I2C_SMBUS_I2C_BLOCK_DATA
        )
        message.data.contents.byte = size
        with self._transfer(register):
            fd = cast("int", self._bus.fd)
            fcntl.ioctl(fd, _I2C_SLAVE, self._address)
            fcntl.ioctl(fd, I2C_SMBUS, message)
        count, *row = message.data.contents.block[: size + 1]
        if count != size:
            raise BadReply(f"{self._where}, register 0x{register:02x}: {count} bytes of {size}")
        return bytes(row)

    def close(self) -> None:
        """Close the bus; must be called only once."""
        self._bus.close()

    @contextmanager
    def _transfer(self, register: int) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise _error(f"{self._where}, register 0x{register:02x}", error) from error


def _swapped(word: int) -> int:
    """Swap the bytes of a word: SMBus sends the lower byte first, these chips send the upper one
    first."""
    return int.from_bytes(word.to_bytes(2, "big"), "little")


def _error(where: str, error: OSError) -> HalError:
    if error.errno in _SILENT:
        return NoReply(f"{where}: no answer ({error.strerror}): look at power, wires and address")
    if error.errno in (errno.ENODEV, errno.EBADF):
        return PortError(f"{where}: the I2C bus is gone ({error.strerror})")
    return BadReply(f"{where}: {error.strerror}")


def _why(error: OSError) -> str:
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"{error.strerror}: put this user into the group i2c"
    if error.errno == errno.ENOENT:
        return "there is no such I2C bus: switch I2C on, load i2c-dev, or look at ls /dev/i2c-*"
    if error.errno == errno.EBUSY:
        return "a driver of the kernel has this device already: use its hwmon, or unbind it"
    return error.strerror or str(error)
