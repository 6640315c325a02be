# SPDX-License-Identifier: Apache-2.0
"""A base with two wheels on one line, for tests of the code around the core; a function to wait."""

import math
import time
from collections.abc import Callable

from motord.realtime import loop as rt
from motord_hal.realtime.exchange import Exchange, now_ns

PATIENCE_S = 30.0
FOREVER_S = 1e4  # a timeout that a busy machine does not reach

AXIS = rt.AxisLimits(
    velocity_u_s=1.0, acceleration_u_s2=50.0, deceleration_u_s2=50.0, jerk_u_s3=math.inf
)
LIMITS = rt.BaseLimits(linear=AXIS, angular=AXIS, lateral=AXIS)


def joint(side: float) -> rt.JointConfig:
    return rt.JointConfig(
        row={"x": 1.0, "y": 0.0, "lever_m": side * 0.2},
        wheel_radius_m=0.1,
        velocity_min_rad_s=-20.0,
        velocity_max_rad_s=20.0,
        rad_per_count=0.001,
        counter_bits=32,
        line=0,
        pwm=rt.PwmConfig(
            dead_band=0.0, duty_min=-1.0, duty_max=1.0, slew_per_s=math.inf, full_duty_rad_s=20.0
        ),
    )


def core_config() -> rt.CoreConfig:
    return rt.CoreConfig(
        joint_count=2,
        limits=LIMITS,
        command_timeout_s=FOREVER_S,
        feedback_timeout_s=FOREVER_S,
        heartbeat_timeout_s=FOREVER_S,
        rest_velocity_rad_s=0.05,
        on_timeout=rt.StopAction.RAMP,
        on_fault=rt.StopAction.RAMP,
        on_estop=rt.StopAction.BRAKE,
        distance_variance_m2_per_m=1e-3,
        turn_variance_rad2_per_rad=1e-3,
        pose_variance_floor_m2=1e-6,
        heading_variance_floor_rad2=1e-6,
        twist_variance_floor_m2_s2=1e-6,
        twist_variance_floor_rad2_s2=1e-6,
        joint=[joint(-1.0), joint(1.0)],
    )


def settings(
    *,
    rate_hz: float = 1000.0,
    priority: int = 80,
    cpu: tuple[int, ...] = (),
    notify_hz: float = 50.0,
    lock_memory: bool = False,
    hold_dma_latency: bool = False,
    late_from_ns: int = 0,
) -> rt.LoopSettings:
    return rt.LoopSettings(
        rate_hz=rate_hz,
        priority=priority,
        cpu=cpu,
        notify_hz=notify_hz,
        lock_memory=lock_memory,
        hold_dma_latency=hold_dma_latency,
        late_from_ns=late_from_ns,
    )


def until(condition: Callable[[], object]) -> None:
    """Wait until the condition holds, at most PATIENCE_S: a busy machine is late, not wrong."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "waited in vain"
        time.sleep(0.002)


def report_wheels(count: int = 0, velocity_rad_s: float = 0.0) -> None:
    """Put feedback by which both drives are present and enabled."""
    exchange = Exchange.of_loop()
    for index in (0, 1):
        exchange.put_feedback(
            index,
            stamp_ns=now_ns(),
            count=count,
            velocity_rad_s=velocity_rad_s,
            epoch=0,
            enabled=True,
            drive_faults=0,
        )


def lease_of(loop: rt.Loop) -> rt.LoopLease:
    """Open the only lease that commands; a command lasts FOREVER_S."""
    return loop.open_lease(lifetime_s=FOREVER_S)


def arm(loop: rt.Loop) -> rt.LoopLease:
    report_wheels()
    lease = lease_of(loop)
    lease.send(0.0, 0.0)
    loop.put_control(rt.Control(limits=LIMITS))
    until(lambda: not set(loop.read_state().reasons) & {"command_stale"})
    loop.put_control(rt.Control(armed=True, limits=LIMITS))
    until(lambda: loop.read_state().armed)
    return lease
