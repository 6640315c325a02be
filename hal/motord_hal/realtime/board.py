# SPDX-License-Identifier: Apache-2.0
"""The interface to the threads in C that drive boards on a serial port: one thread for each board,
its table, its orders, its report.

The meaning of each field is in api_board.h; tables and orders are plain values with these names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from _motord_rt import ffi, lib

from motord_hal.fieldbus.ports import RoundTrips
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
    round_trips_of,
)


class BoardClock:
    """Converts a board's clock to CLOCK_MONOTONIC (csrc/fieldbus/board/board_clock.c), so that the
    age of a frame includes its time in buffers."""

    def __init__(self) -> None:
        self._clock = ffi.new("board_clock *")

    def stamp_ns(self, time_us: int, came_ns: int) -> int:
        """Return the time at which the board made a frame, never later than `came_ns`. `time_us` is
        the board's time in the frame (32 bits). If the result is not later than the stamp before,
        ignore the frame: the next one has the same content."""
        return int(lib.board_clock_stamp(self._clock, time_us, came_ns))


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardDriveReport(OrderedDriveReport):
    """The thread's report of the board. `cycles` counts the feedback passed to the core."""

    knows: bool
    """Whether the board made its newest feedback after it had received all writes."""
    received_ns: int
    """Time of the newest feedback; 0: none was ever received."""
    payload: bytes
    """Payload of the newest feedback; empty: none came since the board was unresponsive, or
    ever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardReport(AnyLineReport):
    cycles: int
    sent: int
    no_room: int
    bad_frames: int
    received: int
    unresponsive: int
    cycle_ns: int
    drives: tuple[BoardDriveReport]


def check_table(name: str, table: Plain) -> None:
    """Check a table as `check_plain` does."""
    check_plain(name, lib.board_table_check, "board_table *", table)


class BoardThread(LineThreadHandle):
    """One board's thread in C, from `start` to `stop`. Use it from one thread at a time. The board
    is drive 0."""

    def __init__(self, line: int, exchange: Exchange) -> None:
        super().__init__(line, ffi.new("board_control *"), lib.board_put_control, lib.board_stop)
        self._exchange = exchange
        self._ordered = 0
        self._report = ffi.new("board_report *")

    def start(self, table: Plain, **config: int) -> None:
        """Start the thread. `config` has the fields of board_config; the caller closes the file
        descriptors in it after `stop`. Raise HalError if the thread does not start."""
        raw = ffi.new("board_table *", table)
        raw_config = ffi.new("board_config *", config_of(config, self._exchange))
        ffi.memmove(self._control, bytes(ffi.sizeof("board_control")), ffi.sizeof("board_control"))
        check_code(lib.board_start(self._line, raw_config, raw), "the line cannot be started")
        self._ordered = 0

    def _request_of(self, drive: int) -> Any:
        del drive
        return self._control.request

    def put_order(self, order: Plain) -> bool:
        """Queue an order; False: the queue is full. Raise HalError if the thread has ended."""
        code = lib.board_put_order(self._line, ffi.new("board_order *", order))
        if not is_taken(code, "the line takes no write"):
            return False
        self._ordered += 1
        return True

    @property
    def ordered(self) -> int:
        """Number of orders since the start; the report has their results."""
        return self._ordered

    def report(self) -> BoardReport:
        """Read the present report of the line."""
        raw = self._report
        lib.board_read_report(self._line, raw)
        drive = value_of(
            BoardDriveReport,
            raw,
            cycles=raw.published,
            knows=raw.knows_ns >= raw.written_ns,
            payload=bytes(ffi.buffer(raw.feedback_payload, raw.feedback_bytes)),
        )
        return report_of(BoardReport, raw, (drive,))

    def round_trips(self) -> RoundTrips:
        """Return the times from set-points to the acknowledging feedback, since the start."""
        return round_trips_of(lib.board_histogram_read, self._line)
