# SPDX-License-Identifier: Apache-2.0
"""What goes into the real-time loop and what it reports about itself, as plain values.

The TypedDicts mirror the structs of csrc/api/api.h field by field, which holds their meanings and
ranges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NotRequired, Required, TypedDict


class AxisLimits(TypedDict):
    """u = m on the linear and the lateral axis, rad on the angular one. Jerk may be infinite: no
    limit."""

    velocity_u_s: float
    acceleration_u_s2: float
    deceleration_u_s2: float
    jerk_u_s3: float


class BaseLimits(TypedDict):
    linear: AxisLimits
    angular: AxisLimits
    lateral: AxisLimits


class WheelRow(TypedDict):
    """Rim speed = x linear + y lateral + lever_m angular."""

    x: float
    y: float
    lever_m: float


class PwmConfig(TypedDict):
    dead_band: float
    duty_min: float
    duty_max: float
    slew_per_s: float
    full_duty_rad_s: float


class SpeedLoopGains(TypedDict, total=False):
    """u: N m of a torque, 1 of a duty. What is left out is 0."""

    gain_u_s_per_rad: float
    integral_u_per_rad: float
    derivative_u_s2_per_rad: float
    static_u: float
    viscous_u_s_per_rad: float
    acceleration_u_s2_per_rad: float


class SpeedLoopConfig(TypedDict):
    gains: SpeedLoopGains
    filter_s: float
    correction_max_u: float
    output_min_u: float
    output_max_u: float
    kind: int
    """A SpeedLoopKind."""


class DeratingRange(TypedDict):
    """`full` == `none`: not in use."""

    full: float
    none: float


class DeratingConfig(TypedDict):
    """By temperature in °C, current in A, voltage in V."""

    range: list[DeratingRange]


class PlausibleConfig(TypedDict, total=False):
    """What is left out is 0; a time of 0 switches its check off."""

    setpoint_min_rad_s: float
    slow_rad_s: float
    short_rad_s: float
    beyond_rad_s: float
    apart_rad_s: float
    progress_rad_s: float
    direction_s: float
    stall_s: float
    following_s: float
    runaway_s: float
    apart_s: float
    jumps_max: int


class PositionConfig(TypedDict, total=False):
    """Of a joint that takes positions. Without it `used` is 0."""

    used: Required[int]
    reference: int
    """A position_reference of csrc/api/api_position.h."""
    zero_count: int
    position_min_rad: float
    position_max_rad: float
    velocity_rad_s: float
    acceleration_rad_s2: float
    following_rad: float
    following_s: float


class JointConfig(TypedDict):
    row: WheelRow
    wheel_radius_m: float
    velocity_min_rad_s: float
    velocity_max_rad_s: float
    rad_per_count: float
    counter_bits: int
    line: int
    pwm: PwmConfig
    speed_loop: NotRequired[SpeedLoopConfig]
    """Only of a joint whose drive takes a torque, or a duty."""
    plausible: NotRequired[PlausibleConfig]
    position: NotRequired[PositionConfig]
    derating: NotRequired[DeratingConfig]
    own: NotRequired[AxisLimits]
    """Of a joint without a base that takes velocities."""


class GyroConfig(TypedDict, total=False):
    """Without a gyro `used` is 0, and the rest may be left out."""

    used: Required[int]
    timeout_s: float
    bias_max_rad_s: float
    still_variance_rad2_s2: float
    heading_variance_rad2_per_s: float
    turn_variance_rad2_per_rad: float


class WheelModule(TypedDict):
    """A wheel of a base with steered wheels; joints by number from 1 on, 0: none."""

    x_m: float
    y_m: float
    angle_rad: float
    steering: int
    traction: int


class CoreConfig(TypedDict):
    joint_count: int
    limits: BaseLimits
    command_timeout_s: float
    feedback_timeout_s: float
    heartbeat_timeout_s: float
    rest_velocity_rad_s: float
    on_timeout: int
    """A StopAction, as the two below."""
    on_fault: int
    on_estop: int
    distance_variance_m2_per_m: float
    turn_variance_rad2_per_rad: float
    pose_variance_floor_m2: float
    heading_variance_floor_rad2: float
    twist_variance_floor_m2_s2: float
    twist_variance_floor_rad2_s2: float
    gyro: NotRequired[GyroConfig]
    module_count: NotRequired[int]
    """Without it the joints' rows count."""
    module: NotRequired[list[WheelModule]]
    independent: NotRequired[int]
    """1: there is no base, and each joint moves for itself."""
    joint: list[JointConfig]


class GuardConfig(TypedDict):
    estop: int
    estop_fd: int
    estop_high: int
    watchdog: int
    watchdog_fd: int
    watchdog_every_ticks: int
    heartbeat_timeout_ns: int
    line_timeout_ns: list[int]


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Never too low: the upper edge of a bucket that is at most 1/16 of its value wide."""

    samples: int
    p50_ns: int
    p99_ns: int
    p99_9_ns: int
    max_ns: int


@dataclass(frozen=True, slots=True)
class Bucket:
    """The number of samples of low_ns or more and less than high_ns; at most 1/16 of its value
    wide."""

    low_ns: int
    high_ns: int
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """How the loop's thread is to run."""

    rate_hz: float
    priority: int
    """SCHED_FIFO 1..99; 0: SCHED_OTHER."""
    cpu: tuple[int, ...] = ()
    """Empty: any."""
    notify_hz: float = 50.0
    """0: woken for changes only."""
    lock_memory: bool = True
    hold_dma_latency: bool = True
    command_fds: tuple[int, ...] = ()
    """Datagram sockets, not blocking, on which commands come in too; they stay the caller's."""
    stop_fd: int = -1
    """A datagram socket, not blocking, on which stop requests come in; it stays the caller's."""
    guard: GuardConfig | None = None
    """The pins of safety. None: there are none."""
    late_from_ns: int = 0
    """Ticks whose wake-up or end is so late are recorded for `Loop.take_late`; 0: none is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopStatus:
    """How it does run. `refusals`: a sentence for each thing that the kernel did not grant."""

    running: bool
    policy: str
    priority: int
    ticks: int
    overruns: int
    page_faults: int
    tick_stamp_ns: int
    refusals: dict[str, str]
    estop_input: str
    """"none", "clear", "active" or "lost": the emergency stop's contact."""
    watchdog: bool
    """The watchdog's pin moves."""
    watchdog_edges: int
    watchdog_errno: int
    """Of the last write to it."""
    late_lost: int = 0
    """Late ticks for which there was no place."""


STAGES = ("wake", "input", "core", "output", "notify")
"""Of a tick, by STAGE_*."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateTick:
    """A tick that was late, and what its thread's counters grew by since the tick before."""

    deadline_ns: int
    stage_ns: tuple[int, ...]
    """By STAGES; the first from the deadline to the wake-up."""
    ready_ns: int | None
    """The thread could have run and had no CPU; None: the kernel does not count it."""
    page_faults: int
    preemptions: int
    cpu: int
    cpu_before: int
    """At the end of the tick before."""

    @property
    def woken_ns(self) -> int:
        """When the thread woke up."""
        return self.deadline_ns + self.stage_ns[0]

    @property
    def end_ns(self) -> int:
        """When its work was done."""
        return self.deadline_ns + sum(self.stage_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class StopRequests:
    """How many of each kind the loop has received since its start; it goes by each until it has
    been acknowledged."""

    stop: int = 0
    estop: int = 0
    disarm: int = 0
    pid: int = 0
    """Process that sent the newest; 0: not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """The daemon's control, as levels and counters: `core_control` without the heartbeat."""

    armed: bool = False
    stop: bool = False
    estop: bool = False
    fault: bool = False
    release: bool = False
    reset_count: int = 0
    odometry_reset_count: int = 0
    machine_state: int = 0
    gains_count: int = 0
    """Another number puts `gains` in force; 0: those of the configuration are."""
    gains: tuple[SpeedLoopGains, ...] = ()
    """By joint."""
    joint_limits_count: int = 0
    """Another number puts `joint_limits` in force; 0: those of the configuration are."""
    joint_limits: tuple[AxisLimits, ...] = ()
    """By joint, without a base."""
    limits: BaseLimits
