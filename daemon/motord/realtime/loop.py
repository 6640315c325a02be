# SPDX-License-Identifier: Apache-2.0
"""The daemon's interface to the C core: its configuration, the real-time loop, the state page.

Names and units are those of csrc/api/api.h, which holds the meaning of each field. All times are
CLOCK_MONOTONIC in nanoseconds. Nothing here waits for longer than one period of the loop.
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
LEASE_NUMBERS = itertools.count(1)  # of the whole process: leases differ by them
_ESTOP_INPUTS = ("none", "clear", "active", "lost")  # by ESTOP_*
_NO_GAINS = {name: 0.0 for name, _ in ffi.typeof("speed_loop_gains").fields}
_POLICIES = {os.SCHED_FIFO: "SCHED_FIFO", os.SCHED_OTHER: "SCHED_OTHER"}
# Once: each call gives the GIL up, and a busy thread gives it back late.
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


class ConfigRefused(ValueError):
    """The core will not run with this. `field`: the first bad one, as `joint[1].wheel_radius_m`."""

    def __init__(self, field: str) -> None:
        super().__init__(f"the core refuses {field}: out of range or not finite")
        self.field = field


def limits_problem(limits: BaseLimits) -> str | None:
    """The first field that is out of range, as `linear.velocity_u_s`; None: all are good."""
    return first_bad(lib.base_limits_check, ffi.new("base_limits *", limits)) or None


def _core_config(config: CoreConfig) -> Any:
    if not len(config["joint"]) == config["joint_count"] <= lib.JOINTS_MAX:
        raise ConfigRefused("joint_count")
    raw = ffi.new("core_config *", config)
    if bad := first_bad(lib.core_config_check, raw):
        raise ConfigRefused(bad)
    return raw


class HistogramKind(enum.IntEnum):
    LATENESS = lib.HISTOGRAM_LATENESS
    """Wake-up after its deadline."""
    STEP = lib.HISTOGRAM_STEP
    """The tick's own work."""
    COMMAND = lib.HISTOGRAM_COMMAND
    """From a command's stamp to the first tick that used it."""


@dataclass(slots=True)
class _Buffers:
    """Made once, so that the border is crossed without a new allocation in C's types."""

    permissions: Any = field(default_factory=lambda: ffi.new("lease_permissions *"))
    commands: Any = field(default_factory=lambda: ffi.new("command_report *"))
    control: Any = field(default_factory=lambda: ffi.new("core_control *"))
    state: Any = field(default_factory=lambda: ffi.new("robot_state *"))
    stops: Any = field(default_factory=lambda: ffi.new("stop_request_report *"))
    status: Any = field(default_factory=lambda: ffi.new("loop_status *"))
    histogram: Any = field(default_factory=lambda: ffi.new("histogram *"))


class Loop:
    """The real-time loop of this process: one at a time, from one Python thread.

    A context manager; or `start` and `stop`, as often as wanted. With `page_name` the state page
    lies in /dev/shm while it runs (docs/state-page.md).
    """

    def __init__(
        self,
        core: CoreConfig,
        settings: LoopSettings,
        page_name: str | None = None,
        *,
        journal: bool = False,
    ) -> None:
        """`journal`: one beside the page. Raises ConfigRefused for what the core refuses,
        ValueError for a CPU beyond 0..63."""
        if any(not 0 <= number <= 63 for number in settings.cpu):
            raise ValueError(f"cpu {settings.cpu}: each is 0..63")
        self._core = _core_config(core)
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
        """Returns after the first tick, disarmed. Nothing may be using the exchange meanwhile: it
        is emptied.

        Raises RuntimeError when a loop runs in this process already, PageInUse when another daemon
        owns the page, ValueError for settings out of range, OSError for what cannot be done
        without.
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
        # whole: cffi leaves the fields that a dictionary does not name as they were, armed too
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
        """The last set-points are zero and not enabled; takes a period at most.

        Not running: nothing to do. Take the reader off `fileno()` before.
        """
        if self._event_fd < 0:
            return
        self._event_fd, self._command_end = -1, None
        with self._release:
            _raise_for(lib.loop_stop(), "loop_stop")

    def grant(self, leases: Iterable[LeaseGrant]) -> None:
        """From the next tick on these may command, and no other. At most LEASES_MAX."""
        raw = self._buffers.permissions
        ffi.memmove(raw, bytes(ffi.sizeof("lease_permissions")), ffi.sizeof("lease_permissions"))
        for place, lease in zip(raw.lease, leases, strict=False):
            place.token = lease.token
            place.number = lease.number
            place.priority = lease.priority
            place.lifetime_ns = lease.lifetime_ns
            place.interval_least_ns = lease.interval_least_ns
            place.barred_until_ns = lease.barred_until_ns
        lib.exchange_put_permissions(self._exchange, raw)

    def send(self, command: bytes) -> None:
        """A command (commands.datagram) by the socket pair that all of them use. Raises
        BlockingIOError where the loop takes none, ValueError where it does not run."""
        if self._command_end is None:
            raise ValueError("the loop does not run")
        self._command_end.send(command)

    def commands(self) -> CommandReport:
        """Which source commands, and what became of each lease; of the last tick in which something
        came or changed."""
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
        """The only lease from now on: for tools and tests, which need no arbitration."""
        return LoopLease(self, priority, lifetime_s)

    def put_control(self, control: Control) -> None:
        """The daemon's control levels, and a heartbeat with them."""
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
        """A heartbeat of asyncio, with the levels of before. From a task, never from a thread."""
        raw = self._buffers.control
        raw.heartbeat_ns = lib.clock_now_ns()
        lib.exchange_put_control(self._exchange, raw)

    def fileno(self) -> int:
        """Readable every `notify_hz` and when reasons, faults, armed or at_rest change, until
        `drain`."""
        if self._event_fd < 0:
            raise ValueError("the loop does not run")
        return self._event_fd

    def drain(self) -> int:
        """How many notifications came since the last time; makes `fileno()` not readable."""
        with contextlib.suppress(BlockingIOError):
            return os.eventfd_read(self.fileno())
        return 0

    def read_state(self) -> Snapshot:
        """The newest tick's; after `stop` the last one's. Raises OSError before the first start."""
        _raise_for(lib.loop_state_read(self._buffers.state), "loop_state_read")
        return _snapshot(self._buffers.state)

    def status(self) -> LoopStatus:
        """What the kernel granted, and the counters; after `stop` the last ones."""
        raw = self._buffers.status
        lib.loop_status_read(raw)
        refused = permissions.Refused(
            scheduler=raw.scheduler_errno,
            affinity=raw.affinity_errno,
            memory_lock=raw.memory_lock_errno,
            dma_latency=raw.dma_latency_errno,
        )
        if refused != self._refused:  # the sentences need a descriptor, which may be lacking later
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
        """What came on `stop_fd` so far."""
        lib.loop_stop_requests(self._buffers.stops)
        stop, estop, disarm = self._buffers.stops.count
        return StopRequests(stop=stop, estop=estop, disarm=disarm, pid=self._buffers.stops.pid)

    def acknowledge_stops(self, requests: StopRequests) -> None:
        """The levels of the last `put_control` hold these: the loop drops its own."""
        lib.loop_acknowledge_stops([requests.stop, requests.estop, requests.disarm])

    def percentiles(self, kind: HistogramKind) -> Percentiles:
        """Of all samples since start or `clear_histograms`; all zero when there is none."""
        raw = self._read_histogram(kind)
        p50_ns, p99_ns, p99_9_ns, max_ns = (
            lib.histogram_percentile_ns(raw, fraction) for fraction in (0.5, 0.99, 0.999, 1.0)
        )
        return Percentiles(raw.samples, p50_ns, p99_ns, p99_9_ns, max_ns)

    def buckets(self, kind: HistogramKind) -> list[Bucket]:
        """Those that hold a sample, in order."""
        raw = self._read_histogram(kind)
        edges_ns = [*_FLOORS_NS, max(raw.max_ns, _FLOORS_NS[-1]) + 1]
        return [
            Bucket(edges_ns[index], edges_ns[index + 1], samples)
            for index, samples in enumerate(raw.bucket)
            if samples
        ]

    def clear_histograms(self) -> None:
        """Done by the loop at its next tick. Raises OSError when it does not run."""
        _raise_for(lib.loop_histogram_clear(), "loop_histogram_clear")

    def take_late(self) -> list[LateTick]:
        """The ticks that were late (`LoopSettings.late_from_ns`) since the last call."""
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
    """A lease that a tool or a test holds by itself."""

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
        """A command of now, or of `stamp_ns`."""
        self._sequence += 1
        stamp_ns = lib.clock_now_ns() if stamp_ns is None else stamp_ns
        token = self._grant.token
        command = datagram(
            token, self._sequence, stamp_ns, linear_m_s, angular_rad_s, lateral_m_s=lateral_m_s
        )
        self._loop.send(command)


def _epoll(fds: tuple[int, ...]) -> select.epoll:
    """What the loop waits for commands with."""
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
