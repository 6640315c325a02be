# SPDX-License-Identifier: Apache-2.0
"""The part that the interfaces to the threads of lines in C share, on any medium.

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
    """What is reported of every drive."""

    mode: Mode
    fault_reasons: FaultReason
    request_seen: int
    stopping: bool
    cycles: int
    stop_waits: bool
    """It has not received, or not acknowledged, all of its newest stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderedDriveReport(AnyDriveReport):
    """The same for a drive that gets orders beside its cycle."""

    stops: int
    epoch: int
    orders_sent: int
    orders_dropped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class AnyLineReport:
    """What every line's thread reports."""

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
    """A line's report, with those of its drives."""
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
    """Since the start of the line."""
    raw = ffi.new("histogram *")
    read_histogram(line, raw)
    p50, p99 = (lib.histogram_percentile_ns(raw, part) for part in (0.5, 0.99))
    return RoundTrips(p50_us=p50 / 1e3, p99_us=p99 / 1e3, max_us=raw.max_ns / 1e3)


def cpu_mask(spec: LineSpec) -> int:
    """Bit n: CPU n."""
    return sum(1 << cpu for cpu in spec.cpu)


def config_of(values: Plain, exchange: Exchange) -> dict[str, Any]:
    """For a thread's config struct: `values` named as in line_place and beside it."""
    place = {name: values[name] for name in _PLACE if name in values}
    rest = {name: value for name, value in values.items() if name not in _PLACE}
    return rest | {"at": place | {"exchange": exchange.handle}}


def check_plain(name: str, check: Callable[[Any, Any], Any], kind: str, table: Plain) -> None:
    """`check` in C, of a table's struct. Raises ProfileError for a bad table, with the first bad
    field's name, and for one with too many entries."""
    try:
        found = first_bad(check, ffi.new(kind, table))
    except (IndexError, OverflowError) as error:
        raise ProfileError(f"{name}: the line cannot run: {error}") from error
    if found:
        raise ProfileError(f"{name}: the line cannot run with {found}")


def check_code(code: int, what: str) -> None:
    """Raises HalError for -errno."""
    if code < 0:
        raise HalError(f"{what}: {os.strerror(-code)}")


def is_taken(code: int, what: str) -> bool:
    """False: the queue is full. Raises HalError where the thread has ended."""
    if code != -errno.EAGAIN:
        check_code(code, what)
    return code != -errno.EAGAIN


class LineThreadHandle:
    """What asyncio requests of one line's thread. One caller's thread at a time."""

    def __init__(
        self,
        line: int,
        control: Any,
        put_control: Callable[[int, Any], None],
        stop: Callable[[int], int],
    ) -> None:
        """`control`: a zeroed struct of the medium's own."""
        self._line = line
        self._control = control
        self._send_control = put_control
        self._stop = stop

    def stop(self) -> None:
        """The thread has ended when this returns. Does nothing without a thread."""
        code = self._stop(self._line)
        if code != -errno.ESRCH:
            check_code(code, "the line cannot be stopped")

    def request_mode(self, drive: int, mode: int) -> int:
        """Request a Mode; returns the request's count, which the report shows when it was seen."""
        raw = self._request_of(drive)
        raw.count += 1
        raw.mode = mode
        self._put_control()
        return int(raw.count)

    def requested(self, drive: int) -> int:
        """The count of the newest request."""
        return int(self._request_of(drive).count)

    def allow_arming(self, drive: int, until_ns: int) -> None:
        """Until then the drive may report that it is enabled although it is not armed; 0: not any
        more."""
        self._request_of(drive).arming_until_ns = until_ns
        self._put_control()

    def shut_down(self) -> None:
        """Quick stop, power off, silence: the report shows when it is done."""
        self._control.shut_down = 1
        self._put_control()

    def _request_of(self, drive: int) -> Any:
        return self._control.drive[drive]

    def _put_control(self) -> None:
        self._send_control(self._line, self._control)
