# SPDX-License-Identifier: Apache-2.0
"""Plain values from the C core's structures, field by field: csrc/api.h has the meanings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from motord.api.commands import LeaseState
from motord.api.snapshot import DoubtSnapshot, ImuSnapshot, JointSnapshot, Snapshot, gyro_word

_ENABLED_UNKNOWN = 2
_GYRO_NONE = 0


def imu_of(raw: Any) -> ImuSnapshot | None:
    """Of an imu_state. None: there is none, or it was never heard."""
    if raw.state == _GYRO_NONE:
        return None
    return ImuSnapshot(
        stamp_ns=raw.stamp_ns,
        angular_rad_s=tuple(raw.angular_rad_s),
        acceleration_m_s2=tuple(raw.acceleration_m_s2),
        bias_rad_s=raw.bias_rad_s,
        bias_variance_rad2_s2=raw.bias_variance_rad2_s2,
        rate_variance_rad2_s2=raw.rate_variance_rad2_s2,
        state=gyro_word(raw.state),
        heading_by_gyro=raw.heading_by_gyro != 0,
        still=raw.still != 0,
        refused=raw.refused,
    )


def doubt_of(raw: Any, words: Sequence[str]) -> DoubtSnapshot | None:
    """Of a feedback_doubt, whose fault is in words. None: there is none."""
    if not words:
        return None
    return DoubtSnapshot(
        since_ns=raw.since_ns,
        setpoint_rad_s=raw.setpoint_rad_s,
        measured_rad_s=raw.measured_rad_s,
        reported_rad_s=raw.reported_rad_s,
        fault=words[0],
        joint=raw.joint,
    )


def joint_of(raw: Any) -> JointSnapshot:
    """Of a joint_state."""
    return JointSnapshot(
        position_rad=raw.position_rad,
        velocity_rad_s=raw.velocity_rad_s,
        setpoint_rad_s=raw.setpoint_rad_s,
        duty=raw.duty,
        current_a=raw.current_a,
        voltage_v=raw.voltage_v,
        temperature_c=raw.temperature_c,
        feedback_age_s=raw.feedback_age_s,
        drive_faults=raw.drive_faults,
        enabled=None if raw.enabled == _ENABLED_UNKNOWN else raw.enabled != 0,
        stale=raw.stale != 0,
        jumps=raw.jumps,
    )


def lease_state_of(raw: Any) -> LeaseState:
    """Of a lease of the command_report."""
    return LeaseState(
        number=raw.number,
        held=raw.held != 0,
        sequence=raw.sequence,
        stamp_ns=raw.stamp_ns,
        expires_ns=raw.expires_ns,
        since=raw.since,
        priority=raw.priority,
        interval_ns=raw.interval_ns,
        linear_m_s=raw.linear_m_s,
        angular_rad_s=raw.angular_rad_s,
    )


def snapshot_of(
    raw: Any, reasons: Sequence[str], faults: Sequence[str], doubts: Sequence[str]
) -> Snapshot:
    """Of a robot_state, with its bits in words."""
    return Snapshot(
        stamp_ns=raw.stamp_ns,
        tick=raw.tick,
        machine_state=raw.machine_state,
        owner=raw.owner,
        reasons=tuple(reasons),
        faults=tuple(faults),
        armed=raw.armed != 0,
        enabled=raw.enabled != 0,
        at_rest=raw.at_rest != 0,
        odometry_degraded=raw.odometry_degraded != 0,
        odometry_epoch=raw.odometry_epoch,
        dt_s=raw.dt_s,
        command_age_s=raw.command_age_s,
        wanted_linear_m_s=raw.wanted_linear_m_s,
        wanted_angular_rad_s=raw.wanted_angular_rad_s,
        setpoint_linear_m_s=raw.setpoint_linear_m_s,
        setpoint_angular_rad_s=raw.setpoint_angular_rad_s,
        saturation=raw.saturation,
        odometry_stamp_ns=raw.odometry_stamp_ns,
        x_m=raw.x_m,
        y_m=raw.y_m,
        heading_rad=raw.heading_rad,
        distance_m=raw.distance_m,
        turned_rad=raw.turned_rad,
        linear_m_s=raw.linear_m_s,
        angular_rad_s=raw.angular_rad_s,
        pose_covariance=tuple(raw.pose_covariance),
        twist_covariance=tuple(raw.twist_covariance),
        joints=tuple(joint_of(raw.joint[i]) for i in range(min(raw.joint_count, len(raw.joint)))),
        imu=imu_of(raw.imu),
        doubt=doubt_of(raw.doubt, doubts),
    )
