# SPDX-License-Identifier: Apache-2.0
"""A small base around the bare core: plain numbers in and out, and time that only ticks advance."""

from __future__ import annotations

import math
from typing import Any

from _motord_rt import ffi, lib

TICK_S = 0.001
TICK_NS = 1_000_000
RAD_PER_COUNT = 2.0 * math.pi / 4096.0
RADIUS_M = 0.1
TRACK_M = 0.5
INFINITE = math.inf
LATERAL = {
    "velocity_u_s": 0.8,
    "acceleration_u_s2": 0.9,
    "deceleration_u_s2": 1.2,
    "jerk_u_s3": 6.0,
}

LINEAR = {
    "velocity_u_s": 1.0,
    "acceleration_u_s2": 1.0,
    "deceleration_u_s2": 1.5,
    "jerk_u_s3": 8.0,
}
ANGULAR = {
    "velocity_u_s": 2.0,
    "acceleration_u_s2": 3.0,
    "deceleration_u_s2": 4.0,
    "jerk_u_s3": 30.0,
}


def joint_config(side: float, **changes: Any) -> dict[str, Any]:
    pwm = {"dead_band": 0.0, "duty_min": -1.0, "duty_max": 1.0}
    pwm |= {"slew_per_s": INFINITE, "full_duty_rad_s": 15.0}
    return {
        "row": {"x": 1.0, "y": 0.0, "lever_m": side * TRACK_M / 2.0},
        "wheel_radius_m": RADIUS_M,
        "velocity_min_rad_s": -15.0,
        "velocity_max_rad_s": 15.0,
        "rad_per_count": RAD_PER_COUNT,
        "counter_bits": 32,
        "line": 0,
        "pwm": pwm,
    } | changes


def torque_loop(
    gain_n_m_s_per_rad: float = 1.0, integral_n_m_per_rad: float = 4.0, most_n_m: float = 8.0
) -> dict[str, Any]:
    """Return a loop with proportional and integral part alone."""
    return {
        "gains": {
            "gain_u_s_per_rad": gain_n_m_s_per_rad,
            "integral_u_per_rad": integral_n_m_per_rad,
        },
        "filter_s": 0.05,
        "correction_max_u": most_n_m,
        "output_min_u": -most_n_m,
        "output_max_u": most_n_m,
        "kind": lib.SPEED_LOOP_TORQUE,
    }


def core_config(joints: int = 2, **changes: Any) -> dict[str, Any]:
    """Return the configuration of a base whose joints alternate: left, right, left, right."""
    return {
        "joint_count": joints,
        "limits": {"linear": dict(LINEAR), "angular": dict(ANGULAR), "lateral": dict(LATERAL)},
        "command_timeout_s": 0.3,
        "feedback_timeout_s": 0.25,
        "heartbeat_timeout_s": 0.5,
        "rest_velocity_rad_s": 0.05,
        "on_timeout": lib.STOP_RAMP,
        "on_fault": lib.STOP_RAMP,
        "on_estop": lib.STOP_BRAKE,
        "distance_variance_m2_per_m": 1e-4,
        "turn_variance_rad2_per_rad": 1e-3,
        "pose_variance_floor_m2": 1e-6,
        "heading_variance_floor_rad2": 1e-6,
        "twist_variance_floor_m2_s2": 1e-5,
        "twist_variance_floor_rad2_s2": 1e-5,
        "joint": [joint_config(-1.0 if j % 2 == 0 else 1.0) for j in range(joints)],
    } | changes


class Rig:
    """A core with wheels that follow their set-points at once, and drives that count.

    `hold`: the input that is not refreshed, "command" or "feedback" or both.
    """

    def __init__(self, config: dict[str, Any] | None = None) -> None:
        values = config if config is not None else core_config()
        self.config = ffi.new("core_config *", values)
        self.state = ffi.new("core_state *")
        assert lib.core_init(self.state, self.config) == 0
        self.input = ffi.new("core_input *")
        self.out = ffi.new("setpoints *")
        self.shown = ffi.new("robot_state *")
        self.hold: set[str] = set()
        self.position_rad = [0.0] * values["joint_count"]
        self.wheel_rad_s = [0.0] * values["joint_count"]
        numbers = range(values["joint_count"])
        self.feedback = [self.input.feedback[j] for j in numbers]
        self._setpoints = [self.out.joint[j] for j in numbers]
        self._counting = [
            (joint.rad_per_count, (1 << (joint.counter_bits or 64)) - 1)
            for joint in (self.config.joint[j] for j in numbers)
        ]
        self.input.now_ns = 1_000_000_000
        self.input.control.limits = values["limits"]
        for feedback in self.feedback:
            feedback.velocity_rad_s = 0.0
            feedback.current_a = feedback.voltage_v = feedback.temperature_c = math.nan
            feedback.enabled = 1

    @property
    def speeds(self) -> list[float]:
        return [setpoint.velocity_rad_s for setpoint in self._setpoints]

    def drive(
        self, linear_m_s: float, angular_rad_s: float = 0.0, lateral_m_s: float = 0.0
    ) -> None:
        self.input.command.linear_m_s = linear_m_s
        self.input.command.lateral_m_s = lateral_m_s
        self.input.command.angular_rad_s = angular_rad_s

    def follow(self, dt_s: float) -> None:
        now_ns = self.input.now_ns
        self.wheel_rad_s = self.speeds
        for j, (rad_per_count, mask) in enumerate(self._counting):
            speed_rad_s, feedback = self.wheel_rad_s[j], self.feedback[j]
            self.position_rad[j] += speed_rad_s * dt_s
            feedback.count = math.floor(self.position_rad[j] / rad_per_count) & mask
            feedback.velocity_rad_s = speed_rad_s
            feedback.stamp_ns = now_ns

    def tick(self) -> Any:
        now_ns = self.input.now_ns = self.input.now_ns + TICK_NS
        if "feedback" not in self.hold:
            self.follow(TICK_S)
        self.input.control.heartbeat_ns = now_ns
        if "command" not in self.hold:
            self.input.command.stamp_ns = now_ns
            self.input.command.expires_ns = now_ns + 1_000_000_000
        lib.core_step(self.state, self.input, TICK_S, self.out, self.shown)
        return self.shown

    def ticks(self, seconds: float) -> Any:
        for _ in range(round(seconds / TICK_S)):
            self.tick()
        return self.shown

    def arm(self) -> Any:
        self.tick()
        self.input.control.armed = 1
        shown = self.tick()
        assert shown.armed == 1, f"reasons {shown.reasons:#x}, faults {shown.faults:#x}"
        return shown

    def moving(self, linear_m_s: float = 0.5, angular_rad_s: float = 0.0) -> Any:
        """Arm and drive until the base is at speed."""
        self.arm()
        self.drive(linear_m_s, angular_rad_s)
        shown = self.ticks(1.5)
        assert shown.setpoint_linear_m_s == linear_m_s
        assert shown.setpoint_angular_rad_s == angular_rad_s
        return shown


def assert_rest(rig: Rig, *, enabled: int | None = None) -> None:
    """Assert that the set-points of all 8 joints are zero. `enabled`: expected `out.enabled`."""
    assert [rig.shown.joint[j].setpoint_rad_s for j in range(8)] == [0.0] * 8
    assert [rig.shown.joint[j].duty for j in range(8)] == [0.0] * 8
    assert (rig.shown.setpoint_linear_m_s, rig.shown.setpoint_angular_rad_s) == (0.0, 0.0)
    assert [rig.out.joint[j].velocity_rad_s for j in range(8)] == [0.0] * 8
    assert [rig.out.joint[j].duty for j in range(8)] == [0.0] * 8
    if enabled is not None:
        assert rig.out.enabled == enabled
