# SPDX-License-Identifier: Apache-2.0
"""The daemon's interface to the C core: its configuration, the real-time loop, the state page.

Names and units are those of csrc/api/api.h, which has the meaning of each field. All times are
CLOCK_MONOTONIC in nanoseconds. No call waits for longer than one period of the loop.
"""

from __future__ import annotations

import contextlib
import enum
import errno
import itertools
import os
import secrets
import select
import socket
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Self

from _motord_rt import ffi, lib

from motord.api.commands import (
    TOKEN_BYTES,
    CommandReport,
    LeaseGrant,
    LeaseState,
    Refusal,
    datagram,
)
from motord.api.page_file import JOURNAL, PageFile, PageInUse
from motord.api.snapshot import Snapshot
from motord.api.state_page import decode
from motord.realtime import permissions
from motord.realtime.raw_config import ConfigRefused, raw_config
from motord.realtime.types import (
    AxisLimits,
    BaseLimits,
    Bucket,
    Control,
    CoreConfig,
    GyroConfig,
    JointConfig,
    LateTick,
    LoopSettings,
    LoopStatus,
    Percentiles,
    PwmConfig,
    StopRequests,
)
from motord_hal.realtime.exchange import first_bad, value_of

__all__ = [
    "AxisLimits",
    "BaseLimits",
    "PwmConfig",
    "JointConfig",
    "CoreConfig",
    "GyroConfig",
    "StopAction",
    "SpeedLoopKind",
    "ConfigRefused",
    "limits_problem",
    "HistogramKind",
    "Percentiles",
    "Bucket",
    "LoopSettings",
    "LoopStatus",
    "LateTick",
    "Control",
    "Loop",
    "PageInUse",
]

LEASES_MAX: int = lib.LEASES_MAX
SOURCE_SILENT_S: int = lib.SOURCE_SILENT_S
LEASE_NUMBERS = itertools.count(1)  # shared by the whole process: each lease has its own number
_ESTOP_INPUTS = ("none", "clear", "active", "lost")  # the index is an ESTOP_* of C
_NO_GAINS = {name: 0.0 for name, _ in ffi.typeof("speed_loop_gains").fields}
_POLICIES = {os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_OTHER: "SCHED_OTHER"}
# Computed once: each call releases the GIL, and a busy thread returns it late.
_FLOORS_NS = tuple(lib.histogram_bucket_floor_ns(i) for i in range(lib.HISTOGRAM_BUCKETS))


class StopAction(enum.IntEnum):
    RAMP = lib.STOP_RAMP
    BRAKE = lib.STOP_BRAKE
    HOLD = lib.STOP_HOLD
    COAST = lib.STOP_COAST


class SpeedLoopKind(enum.IntEnum):
    NONE = lib.SPEED_LOOP_NONE
    TORQUE = lib.SPEED_LOOP_TORQUE
    DUTY = lib.SPEED_LOOP_DUTY


def limits_problem(limits: BaseLimits) -> str | None:
    """Return the first field out of range, e.g. `linear.velocity_u_s`; None: all are good."""
    return first_bad(lib.base_limits_check, ffi.new("base_limits *", limits)) or None


class HistogramKind(enum.IntEnum):
    LATENESS = lib.HISTOGRAM_LATENESS
    """Time from a tick's deadline to the thread's wake-up."""
    STEP = lib.HISTOGRAM_STEP
    """Time of a tick's own work."""
    COMMAND = lib.HISTOGRAM_COMMAND
    """Time from a command's stamp to the first tick that used the command."""


@dataclass(slots=True)
class _Buffers:
    """Buffers of C's types that are made once, so that no call to C has to allocate one."""

    permissions: Any = field(default_factory=lambda: ffi.new("lease_permissions *"))
    commands: Any = field(default_factory=lambda: ffi.new("command_report *"))
    control: Any = field(default_factory=lambda: ffi.new("core_control *"))
    state: Any = field(default_factory=lambda: ffi.new("robot_state *"))
    stops: Any = field(default_factory=lambda: ffi.new("stop_request_report *"))
    status: Any = field(default_factory=lambda: ffi.new("loop_status *"))
    histogram: Any = field(default_factory=lambda: ffi.new("histogram *"))


class Loop:
    """The real-time loop of this process. Run one at a time, and use it from one Python thread.

    Use it as a context manager, or call `start` and `stop`, any number of times. With `page_name`
    the state page is in /dev/shm while the loop runs (docs/state-page.md).
    """

    def __init__(
        self,
        core: CoreConfig,
        settings: LoopSettings,
        page_name: str | None = None,
        *,
        journal: bool = False,
    ) -> None:
        """`journal`: also write a journal, in a file beside the page. Raise ConfigRefused for a
        configuration that the core refuses, ValueError for a CPU that is not in 0..63."""
        if any(not 0 <= number <= 63 for number in settings.cpu):
            raise ValueError(f"cpu {settings.cpu}: each is 0..63")
        self._core = raw_config(core)
        self._limits = core["limits"]
        self._settings = settings
        self._page_name = page_name
        self._has_journal = journal and page_name is not None
        self._buffers = _Buffers()
        self._exchange = lib.loop_exchange()
        self._event_fd = -1
        self._command_end: socket.socket | None = None
        self._release = contextlib.ExitStack()
        self._refused = permissions.Refused()
        self._refusals: dict[str, str] = {}

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the loop, disarmed, and return after its first tick. No other thread may use the
        exchange meanwhile, because it is emptied.

        Raise RuntimeError if a loop runs in this process already, PageInUse if another daemon owns
        the page, ValueError for settings out of range, OSError if the system refuses what the loop
        needs.
        """
        with contextlib.ExitStack() as unless_started:
            page_fd = journal_fd = -1
            if self._page_name is not None:
                page_fd = unless_started.enter_context(PageFile.open(self._page_name)).fd
            if self._page_name is not None and self._has_journal:
                journal = PageFile.open(self._page_name, JOURNAL)
                journal_fd = unless_started.enter_context(journal).fd
            event_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            unless_started.callback(os.close, event_fd)
            command_end, inside = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            unless_started.enter_context(command_end)
            unless_started.enter_context(inside)
            os.set_blocking(command_end.fileno(), False)
            stops = (self._settings.stop_fd,) if self._settings.stop_fd >= 0 else ()
            poller = unless_started.enter_context(
                _epoll((inside.fileno(), *self._settings.command_fds, *stops))
            )
            code = lib.loop_start(
                self._loop_config(page_fd, journal_fd, event_fd, poller.fileno()), self._core
            )
            if code == -errno.EBUSY:
                raise RuntimeError("a loop runs in this process already")
            if code == -errno.EINVAL:
                raise ValueError(f"the loop refuses {self._settings}")
            _raise_for(code, "loop_start")
            self._event_fd, self._command_end = event_fd, command_end
            self._release = unless_started.pop_all()
        # the whole struct: cffi does not change fields that a dictionary does not name, e.g. armed
        self._buffers.control[0] = ffi.new("core_control *", {"limits": self._limits})[0]
        self.beat()

    def _loop_config(self, page_fd: int, journal_fd: int, event_fd: int, command_fd: int) -> Any:
        settings = self._settings
        every = round(settings.rate_hz / settings.notify_hz) if settings.notify_hz > 0 else 0
        return ffi.new(
            "loop_config *",
            {
                "rate_hz": settings.rate_hz,
                "priority": settings.priority,
                "notify_every_ticks": max(every, 1) if settings.notify_hz > 0 else 0,
                "cpu_mask": sum(1 << number for number in set(settings.cpu)),
                "page_fd": page_fd,
                "journal_fd": journal_fd,
                "event_fd": event_fd,
                "command_fd": command_fd,
                "stop_fd": settings.stop_fd,
                "lock_memory": settings.lock_memory,
                "hold_dma_latency": settings.hold_dma_latency,
                "guard": settings.guard or {},
                "late_from_ns": settings.late_from_ns,
            },
        )

    def stop(self) -> None:
        """Stop the loop; its last set-points are zero and not enabled. This takes one period at
        most. Do nothing if it does not run. Remove the event loop's reader of `fileno()` before.
        """
        if self._event_fd < 0:
            return
        self._event_fd, self._command_end = -1, None
        with self._release:
            _raise_for(lib.loop_stop(), "loop_stop")

    def grant(self, leases: Iterable[LeaseGrant], releases: int = 0) -> None:
        """Set the leases, LEASES_MAX at most, that may command from the next tick on. No other
        source may. `releases`: another number than before lets all held leases go on."""
        raw = self._buffers.permissions
        ffi.memmove(raw, bytes(ffi.sizeof("lease_permissions")), ffi.sizeof("lease_permissions"))
        for place, lease in zip(raw.lease, leases, strict=False):
            place.token = lease.token
            place.number = lease.number
            place.priority = lease.priority
            place.lifetime_ns = lease.lifetime_ns
            place.interval_least_ns = lease.interval_least_ns
            place.barred_ns = lease.barred_ns
        raw.releases = releases
        lib.exchange_put_permissions(self._exchange, raw)

    def send(self, command: bytes) -> None:
        """Send a command (commands.datagram) to the loop by a socket pair. Raise BlockingIOError if
        the socket is full, ValueError if the loop does not run."""
        if self._command_end is None:
            raise ValueError("the loop does not run")
        self._command_end.send(command)

    def commands(self) -> CommandReport:
        """Return which source is in command and the state of each lease, as of the newest tick in
        which a command came or something changed."""
        raw = self._buffers.commands
        lib.exchange_take_commands(self._exchange, raw)
        return CommandReport(
            commander=raw.commander,
            accepted=raw.accepted,
            refused={kind: raw.refused[kind] for kind in Refusal},
            sideways=raw.sideways,
            on_spot=raw.on_spot,
            leases={lease.number: _lease_state(lease) for lease in raw.lease if lease.number},
        )

    def open_lease(self, priority: int = 100, lifetime_s: float = 0.3) -> LoopLease:
        """Make a lease that is the only one from now on, for tools and tests."""
        return LoopLease(self, priority, lifetime_s)

    def put_control(self, control: Control) -> None:
        """Pass the daemon's control levels to the loop, with a heartbeat."""
        raw = self._buffers.control
        raw.armed = control.armed
        raw.stop = control.stop
        raw.estop = control.estop
        raw.fault = control.fault
        raw.release = control.release
        raw.reset_count = control.reset_count
        raw.odometry_reset_count = control.odometry_reset_count
        raw.machine_state = control.machine_state
        raw.limits = control.limits
        if raw.gains_count != control.gains_count:
            raw.gains_count = control.gains_count
            raw.gains = [{**_NO_GAINS, **gains} for gains in control.gains]
        if raw.joint_limits_count != control.joint_limits_count:
            raw.joint_limits_count = control.joint_limits_count
            raw.joint_limits = control.joint_limits
        self.beat()

    def beat(self) -> None:
        """Send a heartbeat of asyncio and the same levels as before. Call it from a task, never
        from another thread: it shows that asyncio runs."""
        raw = self._buffers.control
        raw.heartbeat_ns = lib.clock_now_ns()
        lib.exchange_put_control(self._exchange, raw)

    def fileno(self) -> int:
        """Return a file descriptor. It becomes readable `notify_hz` times a second, and when
        reasons, faults, armed or at_rest change; `drain` ends that."""
        if self._event_fd < 0:
            raise ValueError("the loop does not run")
        return self._event_fd

    def drain(self) -> int:
        """Return the number of notifications since the last call, and clear them."""
        with contextlib.suppress(BlockingIOError):
            return os.eventfd_read(self.fileno())
        return 0

    def read_state(self) -> Snapshot:
        """Return the snapshot of the newest tick; after `stop` that of the last one. Raise OSError
        before the first start."""
        _raise_for(lib.loop_state_read(self._buffers.state), "loop_state_read")
        return _snapshot(self._buffers.state)

    def status(self) -> LoopStatus:
        """Return what the kernel granted, and the counters; after `stop` their last values."""
        raw = self._buffers.status
        lib.loop_status_read(raw)
        refused = permissions.Refused(
            scheduler=raw.scheduler_errno,
            affinity=raw.affinity_errno,
            memory_lock=raw.memory_lock_errno,
            dma_latency=raw.dma_latency_errno,
        )
        if refused != self._refused:  # made at once: they need a descriptor, maybe not free later
            cpu = self._settings.cpu
            priority = self._settings.priority
            self._refusals = permissions.sentences(refused, priority=priority, cpu=cpu)
            self._refused = refused
        return value_of(
            LoopStatus,
            raw,
            policy=_POLICIES[raw.policy],
            refusals=dict(self._refusals),
            estop_input=_ESTOP_INPUTS[raw.estop_input],
            watchdog=raw.watchdog_well != 0,
        )

    def stop_requests(self) -> StopRequests:
        """Return the stop requests that came on `stop_fd` so far."""
        lib.loop_stop_requests(self._buffers.stops)
        stop, estop, disarm = self._buffers.stops.count
        return StopRequests(stop=stop, estop=estop, disarm=disarm, pid=self._buffers.stops.pid)

    def acknowledge_stops(self, requests: StopRequests) -> None:
        """Acknowledge stop requests whose levels the last `put_control` has set: from now on the
        loop follows the levels alone."""
        lib.loop_acknowledge_stops([requests.stop, requests.estop, requests.disarm])

    def percentiles(self, kind: HistogramKind) -> Percentiles:
        """Return the percentiles of all samples since the start or `clear_histograms`; all are zero
        if there is no sample."""
        raw = self._read_histogram(kind)
        p50_ns, p99_ns, p99_9_ns, max_ns = (
            lib.histogram_percentile_ns(raw, fraction) for fraction in (0.5, 0.99, 0.999, 1.0)
        )
        return Percentiles(raw.samples, p50_ns, p99_ns, p99_9_ns, max_ns)

    def buckets(self, kind: HistogramKind) -> list[Bucket]:
        """Return the buckets that hold a sample, in the order of their values."""
        raw = self._read_histogram(kind)
        edges_ns = [*_FLOORS_NS, max(raw.max_ns, _FLOORS_NS[-1]) + 1]
        return [
            Bucket(edges_ns[index], edges_ns[index + 1], samples)
            for index, samples in enumerate(raw.bucket)
            if samples
        ]

    def clear_histograms(self) -> None:
        """Let the loop clear its histograms at its next tick. Raise OSError if it does not run."""
        _raise_for(lib.loop_histogram_clear(), "loop_histogram_clear")

    def take_late(self) -> list[LateTick]:
        """Return the ticks since the last call that were late (`LoopSettings.late_from_ns`)."""
        raw = ffi.new("late_tick *")
        found = []
        while lib.loop_late_take(raw):
            ready_ns = raw.ready_ns if raw.ready_ns >= 0 else None
            found.append(value_of(LateTick, raw, ready_ns=ready_ns))
        return found

    def _read_histogram(self, kind: HistogramKind) -> Any:
        _raise_for(lib.loop_histogram_read(kind, self._buffers.histogram), "loop_histogram_read")
        return self._buffers.histogram


class LoopLease:
    """A lease that a tool or a test holds in the same process as the loop."""

    def __init__(self, loop: Loop, priority: int, lifetime_s: float) -> None:
        self._loop = loop
        self._grant = LeaseGrant(
            number=next(LEASE_NUMBERS),
            token=secrets.token_bytes(TOKEN_BYTES),
            priority=priority,
            lifetime_ns=round(lifetime_s * 1e9),
        )
        self._sequence = 0
        loop.grant([self._grant])

    def send(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        stamp_ns: int | None = None,
        *,
        lateral_m_s: float = 0.0,
    ) -> None:
        """Send a command with the stamp `stamp_ns`; None: now."""
        self._sequence += 1
        stamp_ns = lib.clock_now_ns() if stamp_ns is None else stamp_ns
        token = self._grant.token
        command = datagram(
            token, self._sequence, stamp_ns, linear_m_s, angular_rad_s, lateral_m_s=lateral_m_s
        )
        self._loop.send(command)


def _epoll(fds: tuple[int, ...]) -> select.epoll:
    """Make the epoll object that the loop waits on. Raise ValueError for too many sockets."""
    if len(fds) > lib.COMMAND_SOCKETS:
        raise ValueError(f"{len(fds)} sockets for commands, at most {lib.COMMAND_SOCKETS}")
    poller = select.epoll()
    for fd in fds:
        poller.register(fd, select.EPOLLIN)
    return poller


def _raise_for(code: int, what: str) -> None:
    if code < 0:
        raise OSError(-code, f"{what}: {os.strerror(-code)}")


def _lease_state(raw: Any) -> LeaseState:
    joints = raw.joints
    values_u = {j: joints.value_u[j] for j in range(lib.JOINTS_MAX) if joints.named >> j & 1}
    return value_of(LeaseState, raw, joint_values_u=values_u)


def _snapshot(raw: Any) -> Snapshot:
    return decode(bytes(ffi.buffer(raw, ffi.sizeof("robot_state"))))
