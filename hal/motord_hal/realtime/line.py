# SPDX-License-Identifier: Apache-2.0
"""The interface to the serial lines in C: one thread for each line, its table, requests and report.

The meaning of each field is in api_line.h. A running line needs no Python; this module is for
commands of users, faults and parameters.
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass
from typing import Any

from _motord_rt import ffi, lib

from motord_hal.fieldbus.ports import LineSpec, RoundTrips
from motord_hal.realtime.exchange import Exchange, value_of
from motord_hal.realtime.table import LineFrame, LineGroup, LineTable
from motord_hal.realtime.thread import (
    AnyDriveReport,
    AnyLineReport,
    LineThreadHandle,
    check_code,
    check_plain,
    config_of,
    cpu_mask,
    is_taken,
    report_of,
    round_trips_of,
)

DRIVES_MAX: int = lib.LINE_DRIVES_MAX


class AnswerKind(enum.IntEnum):
    OK = lib.ANSWER_OK
    NO_REPLY = lib.ANSWER_NO_REPLY
    BAD_REPLY = lib.ANSWER_BAD_REPLY
    REFUSED = lib.ANSWER_REFUSED
    EXPIRED = lib.ANSWER_EXPIRED
    PORT = lib.ANSWER_PORT
    NEVER_SILENT = lib.ANSWER_NEVER_SILENT


@dataclass(frozen=True, slots=True, kw_only=True)
class ThreadSpec:
    """The port and the scheduling of a line's thread. The caller keeps the file descriptors, and
    closes them after `LineThread.stop`."""

    fd: int
    event_fd: int
    priority: int
    cpu_mask: int = 0
    de_fd: int = -1
    de_active_high: bool = True
    de_before_ns: int = 0
    de_after_ns: int = 0
    may_turn: int = 0
    """Bit n is 1 if drive n was armed before the port was opened; it then gets a stop first."""
    left_running: bool = False
    """See `LineSpec.left_running`."""

    @classmethod
    def of(
        cls, spec: LineSpec, *, fd: int, de_fd: int, event_fd: int, may_turn: int = 0
    ) -> ThreadSpec:
        """Make the ThreadSpec of a LineSpec, which comes from the robot file."""
        return cls(
            fd=fd,
            event_fd=event_fd,
            priority=spec.priority,
            cpu_mask=cpu_mask(spec),
            de_fd=de_fd,
            de_active_high=spec.direction.active_high,
            de_before_ns=round(spec.direction.before_s * 1e9),
            de_after_ns=round(spec.direction.after_s * 1e9),
            may_turn=may_turn,
            left_running=spec.left_running,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LineRequest:
    id: int
    drive: int
    frame: LineFrame
    expires_ns: int
    turnaround_ns: int
    urgent: bool


@dataclass(frozen=True, slots=True)
class Answer:
    id: int
    kind: AnswerKind
    exception: int
    stamp_ns: int
    sent_ns: int
    done_ns: int
    reply: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveReport(AnyDriveReport):
    enabled: bool | None
    """None: the drive cannot report it, or has not reported it since the last request."""
    sent_motion: bool
    may_turn: bool
    """Whether the drive was armed since it was last set up, also before this start."""
    failures: int
    last_failure: AnswerKind
    last_exception: int
    exchanges: int
    no_reply: int
    bad_reply: int
    refused: int
    late: int
    """Number of replies that came after their deadline."""
    deadline_ns: int
    cycle_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LineReport(AnyLineReport):
    exchanges: int
    answers: int
    """Number of good replies and refusals."""
    noise_bytes: int
    """Number of bytes that belong to no frame."""
    drives: tuple[DriveReport, ...]


def check_table(name: str, table: LineTable) -> None:
    """Check a table as `check_plain` does."""
    check_plain(name, lib.line_table_check, "line_table *", _plain(table))


class LineThread(LineThreadHandle):
    """One line's thread in C, from `start` to `stop`. Use it from one thread at a time."""

    def __init__(self, line: int, exchange: Exchange) -> None:
        super().__init__(line, ffi.new("line_control *"), lib.line_put_control, lib.line_stop)
        self._exchange = exchange
        self._drives = 0
        self._raw_request = ffi.new("line_request *")
        self._answer = ffi.new("line_answer *")
        self._report = ffi.new("line_report *")

    def start(self, spec: ThreadSpec, table: LineTable) -> None:
        """Start the thread. Raise HalError if it does not start."""
        raw = ffi.new("line_table *", _plain(table))
        config = ffi.new("line_config *", config_of(dataclasses.asdict(spec), self._exchange))
        ffi.memmove(self._control, bytes(ffi.sizeof("line_control")), ffi.sizeof("line_control"))
        check_code(lib.line_start(self._line, config, raw), "the line cannot be started")
        self._drives = len(table.drive)

    def put_request(self, request: LineRequest) -> bool:
        """Queue a request; False: the queue is full. Raise HalError if the thread has ended."""
        raw = self._raw_request
        raw.id, raw.drive, raw.urgent = request.id, request.drive, request.urgent
        raw.expires_ns, raw.turnaround_ns = request.expires_ns, request.turnaround_ns
        raw.frame = _frame(request.frame)
        return is_taken(lib.line_put_request(self._line, raw), "the line takes no request")

    def take_answer(self) -> Answer | None:
        raw = self._answer
        if lib.line_take_answer(self._line, raw) != 1:
            return None
        return value_of(Answer, raw, reply=bytes(ffi.buffer(raw.reply, raw.reply_bytes)))

    def report(self) -> LineReport:
        """Read the present report of the line."""
        raw = self._report
        lib.line_read_report(self._line, raw)
        drives = tuple(_drive_report(raw.drive[n]) for n in range(self._drives))
        return report_of(LineReport, raw, drives)

    def round_trips(self) -> RoundTrips:
        """Return the round-trip times since the start of the thread."""
        return round_trips_of(lib.line_histogram_read, self._line)


def _drive_report(raw: Any) -> DriveReport:
    enabled = None if raw.enabled > 1 else raw.enabled == 1
    return value_of(DriveReport, raw, enabled=enabled)


def _frame(frame: LineFrame) -> dict[str, Any]:
    values = {field.name: getattr(frame, field.name) for field in dataclasses.fields(frame)}
    sizes = {"request_bytes": len(frame.request), "match_bytes": len(frame.match)}
    return values | sizes | {"request": list(frame.request), "match": list(frame.match)}


def _group(group: LineGroup) -> dict[str, Any]:
    return {
        "used": int(bool(group.write)),
        "data_byte": group.data_byte,
        "write_bytes": len(group.write),
        "read_bytes": len(group.read),
        "fast": group.fast,
        "write": list(group.write),
        "read": list(group.read),
    }


def _plain(value: Any) -> Any:
    """Convert a table to the initialiser that cffi takes for the C struct. Next to each tuple of
    structs its count is added."""
    if isinstance(value, LineFrame):
        return _frame(value)
    if isinstance(value, LineGroup):
        return _group(value)
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if not dataclasses.is_dataclass(value):
        return value
    plain: dict[str, Any] = {}
    for field in dataclasses.fields(value):
        one = getattr(value, field.name)
        plain[field.name] = _plain(one)
        if field.name == "harmless":
            plain["harmless_codes"] = len(one)
        elif isinstance(one, tuple):
            plain[f"{field.name}_count"] = len(one)
    return plain
