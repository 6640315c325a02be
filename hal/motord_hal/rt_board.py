# SPDX-License-Identifier: Apache-2.0
"""The door to the threads that drive boards on a stream: one a board, its table, its orders, its
report.

The meaning of each field is in csrc/api_board.h; tables and orders are plain values named as there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from _motord_rt import ffi

from motord_hal.rt import Exchange
from motord_hal.rt_line import Demoted, Mode, TimedThread, check_plain_table
from motord_hal.rt_thread import LineLife, Plain, life_of


@dataclass(frozen=True, slots=True)
class BoardSays:
    """The board, as its thread sees it."""

    mode: Mode
    demoted: Demoted
    wish_seen: int
    stopping: bool
    cycles: int
    """Feedback that the core was given."""
    stops: int
    stop_waits: bool
    epoch: int
    orders_sent: int
    orders_dropped: int
    knows: bool
    """What it said last, it said when it had heard all that was written to it."""
    heard_ns: int
    """0: never."""
    said: bytes
    """Its newest word; empty: it has not spoken since it was quiet, or ever."""


@dataclass(frozen=True, slots=True)
class BoardReport(LineLife):
    shut_down: bool
    cycles: int
    sent: int
    no_room: int
    bad_frames: int
    received: int
    quiet: int
    cycle_ns: int
    setpoints_ns: int
    fault_words: tuple[int, ...]
    drives: tuple[BoardSays]


def check_table(name: str, table: Plain) -> None:
    """As rt_line.check_table."""
    check_plain_table("board", name, table)


class BoardThread(TimedThread):
    """One board's thread. Its drive has the number 0."""

    def __init__(self, line: int, exchange: Exchange) -> None:
        super().__init__("board", line, exchange)
        self._ordered = 0

    def start(self, table: Plain, **config: int) -> None:
        """`config` as in board_config. Raises HalError."""
        self._start(table, config)
        self._ordered = 0

    def _wish_of(self, drive: int) -> Any:
        assert drive == 0  # there is one
        return self._control.wish

    def put_order(self, order: Plain) -> bool:
        """False: the queue is full. Raises HalError where the thread has ended."""
        taken = self._put("order", ffi.new("board_order *", order))
        self._ordered += taken
        return taken

    @property
    def ordered(self) -> int:
        """Orders since the start; the report says what has become of them."""
        return self._ordered

    def report(self) -> BoardReport:
        """As the line has it now."""
        raw = self._read_report()
        return BoardReport(
            **life_of(raw),
            shut_down=raw.shut_down != 0,
            cycles=raw.cycles,
            sent=raw.sent,
            no_room=raw.no_room,
            bad_frames=raw.bad_frames,
            received=raw.received,
            quiet=raw.quiet,
            cycle_ns=raw.cycle_ns,
            setpoints_ns=raw.setpoints_ns,
            fault_words=tuple(raw.fault_word),
            drives=(_says(raw),),
        )


def _says(raw: Any) -> BoardSays:
    return BoardSays(
        mode=Mode(raw.mode),
        demoted=Demoted(raw.demoted),
        wish_seen=raw.wish_seen,
        stopping=raw.stopping != 0,
        cycles=raw.published,
        stops=raw.stops,
        stop_waits=raw.stop_waits != 0,
        epoch=raw.epoch,
        orders_sent=raw.orders_sent,
        orders_dropped=raw.orders_dropped,
        knows=raw.knows_ns >= raw.written_ns,
        heard_ns=raw.heard_ns,
        said=bytes(ffi.buffer(raw.said, raw.said_bytes)),
    )
