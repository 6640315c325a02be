# SPDX-License-Identifier: Apache-2.0
"""Select the frames of a drive by the protocol of its line."""

from __future__ import annotations

from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.modbus.codec import frame_time_s
from motord_hal.modbus.plan import DrivePlan
from motord_hal.modbus.timing import line_gap_s
from motord_hal.rt_engine.rs485.ddsm_frames import DdsmFrames
from motord_hal.rt_engine.rs485.frames import DriveFrames
from motord_hal.rt_engine.rs485.modbus_frames import ModbusFrames
from motord_hal.rt_engine.rs485.roboclaw_frames import RoboclawFrames
from motord_hal.rt_engine.rs485.servo_frames import ServoFrames
from motord_hal.servo.packets import KINDS as SERVO_KINDS


def frames_of(spec: LineSpec) -> list[DriveFrames]:
    """Return the frames of each unit on a line. Raise ProfileError if joints cannot share it."""
    for joint in spec.joints:
        if joint.profile.protocol != spec.kind:
            raise ProfileError(
                f"{joint.name}: {joint.profile.name} speaks {joint.profile.protocol}, "
                f"and {spec.name} is a {spec.kind} line"
            )
    return [frames_for(spec, joints) for joints in joints_by_unit(spec)]


def frames_for(spec: LineSpec, joints: list[JointSpec]) -> DriveFrames:
    """Return the frames of one unit on the line."""

    def wire_time_s(size_bytes: int) -> float:
        return frame_time_s(size_bytes, spec.baudrate, spec.parity, spec.stop_bits)

    if spec.kind == "ddsm":
        return DdsmFrames(joints, line_gap_s(spec), wire_time_s)
    if spec.kind in SERVO_KINDS:
        return ServoFrames(joints, line_gap_s(spec), wire_time_s)
    if spec.kind == "roboclaw":
        return RoboclawFrames(joints, line_gap_s(spec), wire_time_s)
    return ModbusFrames(DrivePlan(joints, line_gap_s(spec), wire_time_s))
