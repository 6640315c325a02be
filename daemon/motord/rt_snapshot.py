# SPDX-License-Identifier: Apache-2.0
"""Parts of a snapshot from the C core's structures, field by field: csrc/api.h has the meanings."""

from __future__ import annotations

from typing import Any

from motord.snapshot import ImuSnapshot, JointSnapshot, gyro_word

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
