# SPDX-License-Identifier: Apache-2.0
"""Input of the real-time loop and its reports about itself, as plain values.

The TypedDicts have the same fields as the structs in csrc/api/api.h, where their meanings and
ranges are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NotRequired, Required, TypedDict


class AxisLimits(TypedDict):
    """Limits of one axis. The unit u is m on the linear and the lateral axis, rad on the angular
    one. An infinite jerk means no limit."""

    velocity_u_s: float
    acceleration_u_s2: float
    deceleration_u_s2: float
    jerk_u_s3: float


class BaseLimits(TypedDict):
    linear: AxisLimits
    angular: AxisLimits
    lateral: AxisLimits


class WheelRow(TypedDict):
    """Factors from the base's twist to a wheel: rim speed = x linear + y lateral + lever_m
    angular."""

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
    """Gains of a speed loop. The unit u is N m for a torque, 1 for a duty. A missing gain is 0."""

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
    """Value of a SpeedLoopKind."""


class DeratingRange(TypedDict):
    """The two measured values between which the speed limits fall linearly: whole at `full`, zero
    at `none`. If both are equal, there is no such derating."""

    full: float
    none: float


class DeratingConfig(TypedDict):
    """Ranges for the derating by temperature (°C), current (A) and voltage (V), in this order."""

    range: list[DeratingRange]


class PlausibleConfig(TypedDict, total=False):
    """Thresholds of the plausibility checks. A missing one is 0; a time of 0 switches its check
    off."""

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
    """Settings of a joint that takes positions. For other joints `used` is 0."""

    used: Required[int]
    reference: int
    """Value of the enum position_reference in csrc/api/api_position.h."""
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
    unmeasured: NotRequired[int]
    counter_mantissa_bits: NotRequired[int]
    pwm: PwmConfig
    speed_loop: NotRequired[SpeedLoopConfig]
    """Only for a joint whose drive takes a torque or a duty."""
    plausible: NotRequired[PlausibleConfig]
    position: NotRequired[PositionConfig]
    derating: NotRequired[DeratingConfig]
    own: NotRequired[AxisLimits]
    """Limits of a joint that takes velocities, on a robot without a base."""


class GyroConfig(TypedDict, total=False):
    """Settings of the gyro. Without a gyro `used` is 0, and the other fields may be missing."""

    used: Required[int]
    timeout_s: float
    bias_max_rad_s: float
    still_variance_rad2_s2: float
    heading_variance_rad2_per_s: float
    turn_variance_rad2_per_rad: float


class WheelModule(TypedDict):
    """A wheel of a base with steered wheels. `steering` and `traction` are joint numbers from 1 on;
    0: there is no such joint."""

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
    """Value of a StopAction, like the next two fields."""
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
    """If it is missing, the rows of the joints describe the base."""
    module: NotRequired[list[WheelModule]]
    independent: NotRequired[int]
    """1: there is no base, and each joint moves by itself."""
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
    """Percentiles of a histogram. Each is the upper edge of a bucket, which is at most 1/16 of its
    value wide, so it is never too low."""

    samples: int
    p50_ns: int
    p99_ns: int
    p99_9_ns: int
    max_ns: int


@dataclass(frozen=True, slots=True)
class Bucket:
    """The number of samples of at least low_ns and less than high_ns. A bucket is at most 1/16 of
    its value wide."""

    low_ns: int
    high_ns: int
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSettings:
    """Settings of the loop's thread."""

    rate_hz: float
    priority: int
    """Priority 1..99 with SCHED_FIFO; 0: SCHED_OTHER."""
    cpu: tuple[int, ...] = ()
    """CPUs on which the thread may run; empty: all."""
    notify_hz: float = 50.0
    """Rate at which the loop wakes asyncio; 0: only when something changes."""
    lock_memory: bool = True
    hold_dma_latency: bool = True
    command_fds: tuple[int, ...] = ()
    """More non-blocking datagram sockets on which commands come in. The caller closes them."""
    stop_fd: int = -1
    """Non-blocking datagram socket on which stop requests come in. The caller closes it."""
    guard: GuardConfig | None = None
    """The safety pins; None: there are no such pins."""
    late_from_ns: int = 0
    """Lateness of a tick's wake-up or end from which the tick is recorded for `Loop.take_late`; 0:
    nothing is recorded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopStatus:
    """How the loop's thread actually runs. `refusals` has a sentence for each request that the
    kernel did not grant."""

    running: bool
    policy: str
    priority: int
    ticks: int
    overruns: int
    page_faults: int
    tick_stamp_ns: int
    refusals: dict[str, str]
    estop_input: str
    """State of the emergency stop's contact: "none", "clear", "active" or "lost"."""
    watchdog: bool
    """Whether the watchdog's pin moves."""
    watchdog_edges: int
    watchdog_errno: int
    """errno of the last write to the watchdog's pin."""
    late_lost: int = 0
    """Number of late ticks that were not recorded, because there was no space."""


STAGES = ("wake", "input", "core", "output", "notify")
"""The stages of a tick, in the order of STAGE_* in C."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LateTick:
    """A tick that was late, and the growth of its thread's counters since the tick before."""

    deadline_ns: int
    stage_ns: tuple[int, ...]
    """Duration of each of STAGES; the first is from the deadline to the wake-up."""
    ready_ns: int | None
    """Time in which the thread was ready but had no CPU; None: the kernel does not count it."""
    page_faults: int
    preemptions: int
    cpu: int
    cpu_before: int
    """CPU at the end of the tick before."""

    @property
    def woken_ns(self) -> int:
        """Time at which the thread woke up."""
        return self.deadline_ns + self.stage_ns[0]

    @property
    def end_ns(self) -> int:
        """Time at which the tick's work was done."""
        return self.deadline_ns + sum(self.stage_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class StopRequests:
    """The number of stop requests of each kind that the loop has received since its start. It
    follows each until `Loop.acknowledge_stops`."""

    stop: int = 0
    estop: int = 0
    disarm: int = 0
    pid: int = 0
    """Process that sent the newest request; 0: not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """The daemon's control of the core, as levels and counters: the struct core_control without
    its heartbeat."""

    armed: bool = False
    stop: bool = False
    estop: bool = False
    fault: bool = False
    release: bool = False
    reset_count: int = 0
    odometry_reset_count: int = 0
    machine_state: int = 0
    gains_count: int = 0
    """A change puts `gains` in force; 0: those of the configuration are in force."""
    gains: tuple[SpeedLoopGains, ...] = ()
    """Gains of each joint, in the order of the joints."""
    joint_limits_count: int = 0
    """A change puts `joint_limits` in force; 0: those of the configuration are in force."""
    joint_limits: tuple[AxisLimits, ...] = ()
    """Limits of each joint of a robot without a base, in the order of the joints."""
    limits: BaseLimits
