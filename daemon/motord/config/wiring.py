# SPDX-License-Identifier: Apache-2.0
"""The robot file's lines as the hardware layer sees them."""

from __future__ import annotations

from motord.config.model import Joint, Robot, RtuLine
from motord.config.wheels import Profiles
from motord_hal.ports import JointSpec, LineSpec


def line_specs(robot: Robot, profiles: Profiles) -> tuple[LineSpec, ...]:
    """One for each line, in the file's order; joints keep their place in the whole robot."""
    return tuple(
        _line_spec(robot, profiles, index, name, line)
        for index, (name, line) in enumerate(robot.line.items())
    )


def _line_spec(robot: Robot, profiles: Profiles, index: int, name: str, line: RtuLine) -> LineSpec:
    joints = tuple(
        _joint_spec(profiles, place, joint_name, joint)
        for place, (joint_name, joint) in enumerate(robot.joint.items())
        if joint.line == name
    )
    return LineSpec(
        index=index,
        name=name,
        kind=line.kind,
        port=line.port,
        baudrate=line.baudrate,
        parity=line.parity,
        stop_bits=line.stop_bits,
        cycle_hz=line.cycle_hz,
        gap_s=line.gap_s,
        engine=line.engine,
        joints=joints,
        watchdog_s=robot.safety.drive_watchdog_s,
    )


def _joint_spec(profiles: Profiles, index: int, name: str, joint: Joint) -> JointSpec:
    return JointSpec(
        index=index,
        name=name,
        profile=profiles[joint.drive],
        unit=joint.unit,
        channel=joint.channel,
        gear_ratio=joint.gear_ratio,
        inverted=joint.inverted,
        tries=joint.tries,
        reply_timeout_s=joint.reply_timeout_s,
    )
