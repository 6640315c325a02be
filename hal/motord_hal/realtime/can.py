# SPDX-License-Identifier: Apache-2.0
"""The interface to the CAN lines in C: one thread for each line, its table, orders and report.

The meaning of each field is in api_can.h; tables, frames and orders are plain values with these
names.
"""

from __future__ import annotations

from dataclasses import dataclass

from _motord_rt import ffi, lib

from motord_hal.realtime.exchange import Exchange, value_of
from motord_hal.realtime.thread import (
    AnyLineReport,
    LineThreadHandle,
    OrderedDriveReport,
    Plain,
    check_code,
    check_plain,
    config_of,
    is_taken,
    report_of,
)

DRIVES_MAX: int = lib.CAN_DRIVES_MAX
SENDINGS_MAX: int = lib.CAN_SENDINGS_MAX
EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
"""Flag bits in the identifier of a frame (linux/can.h)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanDriveReport(OrderedDriveReport):
    missing: int
    faults: int
    last_fault: int
    last_fault_joint: int
    may_turn: bool
    """Whether the drive was armed since it was last set up, also before this start."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CanReport(AnyLineReport):
    cycles: int
    received: int
    sent: int
    tx_full: int
    bad_frames: int
    dropped: int
    foreign: int
    """Frames of another node with an identifier that motord sends."""
    foreign_sending: int
    """Number of the newest such identifier among the table's `sending`."""
    cycle_ns: int
    drives: tuple[CanDriveReport, ...]


@dataclass(frozen=True, slots=True)
class Received:
    """A frame of a drive, or an error frame of the controller."""

    drive: int
    """Number of the drive in the table; DRIVES_MAX: an error frame."""
    identifier: int
    """Identifier with its flag bits (EXTENDED, REMOTE, ERROR)."""
    data: bytes


def check_table(name: str, table: Plain) -> None:
    """Check a table as `check_plain` does."""
    check_plain(name, lib.can_table_check, "can_table *", table)


class CanThread(LineThreadHandle):
    """One CAN line's thread in C, from `start` to `stop`. Use it from one thread at a time."""

    def __init__(self, line: int, exchange: Exchange) -> None:
        super().__init__(line, ffi.new("can_control *"), lib.can_put_control, lib.can_stop)
        self._exchange = exchange
        self._drives = 0
        self._ordered: list[int] = []
        self._received = ffi.new("can_received *")
        self._report = ffi.new("can_report *")

    def start(self, table: Plain, *, before: Plain, **config: int) -> None:
        """Start the thread. `before` has the fields of can_before, `config` those of can_config;
        the caller closes the file descriptors in it after `stop`. Raise HalError if the thread does
        not start."""
        raw = ffi.new("can_table *", table)
        own = config_of(config, self._exchange) | {"before": before}
        raw_config = ffi.new("can_config *", own)
        ffi.memmove(self._control, bytes(ffi.sizeof("can_control")), ffi.sizeof("can_control"))
        check_code(lib.can_start(self._line, raw_config, raw), "the line cannot be started")
        self._drives = raw.drive_count
        self._ordered = [0] * self._drives

    def listen(self, drive: int, *, wanted: bool) -> None:
        """Set whether `take` gets the frames of a drive."""
        bit = 1 << drive
        self._control.listen = self._control.listen & ~bit | bit * wanted
        self._put_control()

    def put_order(self, order: Plain) -> bool:
        """Queue an order; False: the queue is full. Raise HalError if the thread has ended."""
        code = lib.can_put_order(self._line, ffi.new("can_order *", order))
        if not is_taken(code, "the line takes no frame"):
            return False
        self._ordered[order["drive"]] += 1
        return True

    def ordered(self, drive: int) -> int:
        """Return the number of orders for a drive since the start; the report has their results."""
        return self._ordered[drive]

    def take(self) -> Received | None:
        """Return the next frame that the thread passes to Python; None: no frame waits."""
        raw = self._received
        if lib.can_take_received(self._line, raw) != 1:
            return None
        packet = raw.packet
        return Received(raw.drive, packet.id, bytes(ffi.buffer(packet.data, packet.bytes)))

    def report(self) -> CanReport:
        """Read the present report of the line."""
        raw = self._report
        lib.can_read_report(self._line, raw)
        drives = tuple(value_of(CanDriveReport, raw.drive[n]) for n in range(self._drives))
        return report_of(CanReport, raw, drives)
