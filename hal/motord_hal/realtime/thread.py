# SPDX-License-Identifier: Apache-2.0
"""What the interfaces to the threads of lines in C share, on every medium.

The meaning of each field is in csrc/api/line/api_line.h.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from _motord_rt import ffi, lib

from motord_hal.base.errors import HalError, ProfileError
from motord_hal.fieldbus.ports import LineSpec, RoundTrips
from motord_hal.realtime.drive_state import FaultReason, Mode
from motord_hal.realtime.exchange import Exchange, first_bad, value_of

Plain = Mapping[str, Any]

_PLACE = ("fd", "event_fd", "priority", "cpu_mask")


@dataclass(frozen=True, slots=True, kw_only=True)
class AnyDriveReport:
    """The report of a drive: the fields that it has on every medium."""

    mode: Mode
    fault_reasons: FaultReason
    request_seen: int
    stopping: bool
    cycles: int
    stop_waits: bool
    """True: the drive has not received, or not acknowledged, all of its newest stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderedDriveReport(AnyDriveReport):
    """The report of a drive that also gets orders (frames or writes of jobs) beside its cycle."""

    stops: int
    epoch: int
    orders_sent: int
    orders_dropped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class AnyLineReport:
    """The report of a line's thread: the fields that it has on every medium."""

    running: bool
    error: int
    policy: int
    scheduler_errno: int
    page_faults: int
    shut_down: bool
    setpoints_ns: int
    fault_words: tuple[int, ...]
    drives: tuple[AnyDriveReport, ...]


Report = TypeVar("Report", bound=AnyLineReport)


def report_of(kind: Callable[..., Report], raw: Any, drives: tuple[Any, ...]) -> Report:
    """Convert a line's report from C; `drives` are the reports of its drives."""
    life = raw.life
    return value_of(
        kind,
        raw,
        running=life.running != 0,
        error=life.error,
        policy=life.policy,
        scheduler_errno=life.scheduler_errno,
        page_faults=life.page_faults,
        fault_words=tuple(raw.fault_word),
        drives=drives,
    )


def round_trips_of(read_histogram: Callable[[int, Any], None], line: int) -> RoundTrips:
    """Return the round-trip times since the start of the line's thread."""
    raw = ffi.new("histogram *")
    read_histogram(line, raw)
    p50, p99 = (lib.histogram_percentile_ns(raw, part) for part in (0.5, 0.99))
    return RoundTrips(p50_us=p50 / 1e3, p99_us=p99 / 1e3, max_us=raw.max_ns / 1e3)


def cpu_mask(spec: LineSpec) -> int:
    """Return the mask of the CPUs of the line's thread: bit n is CPU n; 0: all CPUs."""
    return sum(1 << cpu for cpu in spec.cpu)


def config_of(values: Plain, exchange: Exchange) -> dict[str, Any]:
    """Return the initialiser of a thread's config struct. The keys of `values` are the names of the
    fields, those of line_place among them."""
    place = {name: values[name] for name in _PLACE if name in values}
    rest = {name: value for name, value in values.items() if name not in _PLACE}
    return rest | {"at": place | {"exchange": exchange.handle}}


def check_plain(name: str, check: Callable[[Any, Any], Any], kind: str, table: Plain) -> None:
    """Check the table of line `name` with `check` in C. `kind` is the C type. Raise ProfileError
    for too many entries, or with the name of the first bad field."""
    try:
        found = first_bad(check, ffi.new(kind, table))
    except (IndexError, OverflowError) as error:
        raise ProfileError(f"{name}: the line cannot run: {error}") from error
    if found:
        raise ProfileError(f"{name}: the line cannot run with {found}")


def check_code(code: int, what: str) -> None:
    """Raise HalError if a result from C is -errno."""
    if code < 0:
        raise HalError(f"{what}: {os.strerror(-code)}")


def is_taken(code: int, what: str) -> bool:
    """Return whether the thread's queue took an entry; False: it is full. Raise HalError if the
    thread has ended."""
    if code != -errno.EAGAIN:
        check_code(code, what)
    return code != -errno.EAGAIN


class LineThreadHandle:
    """Sends the requests of asyncio to one line's thread. Use it from one thread at a time."""

    def __init__(
        self,
        line: int,
        control: Any,
        put_control: Callable[[int, Any], None],
        stop: Callable[[int], int],
    ) -> None:
        """`control` is a zeroed control struct of the medium, for example line_control."""
        self._line = line
        self._control = control
        self._send_control = put_control
        self._stop = stop

    def stop(self) -> None:
        """End the thread and wait for its end. Do nothing if there is no thread."""
        code = self._stop(self._line)
        if code != -errno.ESRCH:
            check_code(code, "the line cannot be stopped")

    def request_mode(self, drive: int, mode: int) -> int:
        """Request a Mode of a drive. Return the count of the request, which the report shows as
        `request_seen` once the thread has seen it."""
        raw = self._request_of(drive)
        raw.count += 1
        raw.mode = mode
        self._put_control()
        return int(raw.count)

    def requested(self, drive: int) -> int:
        """Return the count of the newest request."""
        return int(self._request_of(drive).count)

    def allow_arming(self, drive: int, until_ns: int) -> None:
        """Allow that the drive, until `until_ns`, reports that it is enabled although it is not
        armed; 0 ends the permission."""
        self._request_of(drive).arming_until_ns = until_ns
        self._put_control()

    def shut_down(self) -> None:
        """Request a quick stop, then a power-off, then silence. The report shows the end of it."""
        self._control.shut_down = 1
        self._put_control()

    def _request_of(self, drive: int) -> Any:
        return self._control.drive[drive]

    def _put_control(self) -> None:
        self._send_control(self._line, self._control)
