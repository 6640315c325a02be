# SPDX-License-Identifier: Apache-2.0
"""Errors of the hardware layer, sorted by what you can do about them.

    HalError
    ├── PortError        the port is absent, busy or was pulled: check cable, path and owner
    ├── NoReply          (also TimeoutError) a drive sent nothing in time: power, unit id, baud rate
    ├── BadReply         bytes came that are not the answer: noise, wrong unit id, two masters
    ├── Refused          the drive understood and refused (Modbus exception): profile or drive state
    ├── DriveFault       the drive reports a fault of its own: its manual, then reset
    │   └── WrongDrive   another drive answers than the one that the robot file names
    └── ProfileError     the drive profile cannot be used: correct the file

Every message states what happened, where, and the numbers.
"""

from __future__ import annotations

import termios

SYSTEM_ERRORS = (OSError, termios.error)
"""Errors of system calls on a medium. Its module turns them into a PortError; one that gets past it
is a bug of motord, which may cost that medium, but not the daemon."""


class HalError(Exception):
    """Base class of all errors that the hardware layer reports."""


class PortError(HalError):
    """The port cannot be opened, or was lost."""


class NoReply(HalError, TimeoutError):
    """The other side sent nothing in time."""


class BadReply(HalError):
    """Bytes came, but not the requested answer."""


class Refused(HalError):
    """The drive answered with an exception code."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class DriveFault(HalError):
    """The drive reports a fault."""


class WrongDrive(DriveFault):
    """Another drive answers than the one that the robot file names."""


class ProfileError(HalError):
    """A drive profile is wrong; the message lists every problem as `file: key: problem`."""


def first_of(group: BaseExceptionGroup[Exception]) -> Exception:
    """Return the first error in a group of a TaskGroup, however deep it is nested."""
    first = group.exceptions[0]
    return first_of(first) if isinstance(first, BaseExceptionGroup) else first
