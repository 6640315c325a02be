# SPDX-License-Identifier: Apache-2.0
"""The interface to the threads that drive boards on a stream: one a board, its table, its orders,
its report.

The meaning of each field is in api_board.h; tables and orders are plain values named as there.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass
from typing import Any

from _motord_rt import ffi, lib

from motord_hal.fieldbus.ports import RoundTrips
from motord_hal.realtime.drive_state import FaultReason, Mode
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.thread import (
    LineLife,
    LineThreadHandle,
    Plain,
    check_code,
    check_plain,
    config_of,
    life_of,
)


class BoardClock:
    """A board's clock on ours, csrc/fieldbus/board/board_clock.c: what waited in a buffer
    is as old as it is."""

    def __init__(self) -> None:
        self._clock = ffi.new("board_clock *")

    def stamp_ns(self, time_us: int, came_ns: int) -> int:
        """When a frame with the board's time `time_us` (32 bits) was made; never after it came. Not
        later than the stamp before: it is no news, and the next one will hold what it held."""
        return int(lib.board_clock_stamp(self._clock, time_us, came_ns))


@dataclass(frozen=True, slots=True)
class BoardDriveReport:
    """The board, as its thread sees it."""

    mode: Mode
    fault_reasons: FaultReason
    request_seen: int
    stopping: bool
    cycles: int
    """Feedback that the core was given."""
    stops: int
    stop_waits: bool
    epoch: int
    orders_sent: int
    orders_dropped: int
    knows: bool
    """Its newest report is from after it had received all that was written to it."""
    received_ns: int
    """0: never."""
    payload: bytes
    """Of its newest report; empty: none has come since it was unresponsive, or ever."""


@dataclass(frozen=True, slots=True)
class BoardReport(LineLife):
    shut_down: bool
    cycles: int
    sent: int
    no_room: int
    bad_frames: int
    received: int
    unresponsive: int
    cycle_ns: int
    setpoints_ns: int
    fault_words: tuple[int, ...]
    drives: tuple[BoardDriveReport]


def check_table(name: str, table: Plain) -> None:
    """Raises ProfileError for a table that no line runs, with the first bad field's name."""
    field = ffi.new("char[]", lib.FIELD_NAME_BYTES)

    def first_bad() -> str:
        found = lib.board_table_check(ffi.new("board_table *", table), field)
        return "" if found == ffi.NULL else ffi.string(found).decode()

    check_plain(name, first_bad)


class BoardThread(LineThreadHandle):
    """One board's thread in C, from `start` to `stop`. One caller's thread at a time. Its drive has
    the number 0."""

    def __init__(self, line: int, exchange: Exchange) -> None:
        super().__init__(line, ffi.new("board_control *"), lib.board_put_control, lib.board_stop)
        self._exchange = exchange
        self._ordered = 0
        self._report = ffi.new("board_report *")
        self._histogram = ffi.new("histogram *")

    def start(self, table: Plain, **config: int) -> None:
        """`config` as in board_config; the descriptors stay the caller's, to be closed after
        `stop`. Raises HalError."""
        raw = ffi.new("board_table *", table)
        raw_config = ffi.new("board_config *", config_of(config, self._exchange))
        ffi.memmove(self._control, bytes(ffi.sizeof("board_control")), ffi.sizeof("board_control"))
        check_code(lib.board_start(self._line, raw_config, raw), "the line cannot be started")
        self._ordered = 0

    def _request_of(self, drive: int) -> Any:
        del drive
        return self._control.request

    def put_order(self, order: Plain) -> bool:
        """False: the queue is full. Raises HalError where the thread has ended."""
        code = lib.board_put_order(self._line, ffi.new("board_order *", order))
        if code == -errno.EAGAIN:
            return False
        check_code(code, "the line takes no write")
        self._ordered += 1
        return True

    @property
    def ordered(self) -> int:
        """Orders since the start; the report says what has become of them."""
        return self._ordered

    def report(self) -> BoardReport:
        """As the line has it now."""
        raw = self._report
        lib.board_read_report(self._line, raw)
        return BoardReport(
            **life_of(raw),
            shut_down=raw.shut_down != 0,
            cycles=raw.cycles,
            sent=raw.sent,
            no_room=raw.no_room,
            bad_frames=raw.bad_frames,
            received=raw.received,
            unresponsive=raw.unresponsive,
            cycle_ns=raw.cycle_ns,
            setpoints_ns=raw.setpoints_ns,
            fault_words=tuple(raw.fault_word),
            drives=(_drive_report(raw),),
        )

    def round_trips(self) -> RoundTrips:
        """From set-points to the feedback that acknowledged them, since the start."""
        lib.board_histogram_read(self._line, self._histogram)
        p50, p99 = (lib.histogram_percentile_ns(self._histogram, f) for f in (0.5, 0.99))
        return RoundTrips(p50_us=p50 / 1e3, p99_us=p99 / 1e3, max_us=self._histogram.max_ns / 1e3)


def _drive_report(raw: Any) -> BoardDriveReport:
    return BoardDriveReport(
        mode=Mode(raw.mode),
        fault_reasons=FaultReason(raw.fault_reasons),
        request_seen=raw.request_seen,
        stopping=raw.stopping != 0,
        cycles=raw.published,
        stops=raw.stops,
        stop_waits=raw.stop_waits != 0,
        epoch=raw.epoch,
        orders_sent=raw.orders_sent,
        orders_dropped=raw.orders_dropped,
        knows=raw.knows_ns >= raw.written_ns,
        received_ns=raw.received_ns,
        payload=bytes(ffi.buffer(raw.feedback_payload, raw.feedback_bytes)),
    )
