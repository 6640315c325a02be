# SPDX-License-Identifier: Apache-2.0
"""The robot file's lines as the hardware layer sees them."""

from __future__ import annotations

from dataclasses import replace

from motord.config.sections.bases import side_of
from motord.config.sections.imu import LineImu
from motord.config.sections.joint.wheels import (
    Profiles,
    counts_per_turn,
    rad_per_count,
    takes_position,
    velocity_range_rad_s,
)
from motord.config.sections.line import (
    AnyLine,
    AsciiLine,
    CanLine,
    DynamixelLine,
    PwmLine,
    SerialLine,
)
from motord.config.sections.model import Joint, Robot
from motord_hal.drives.profile import DriveProfile, Gap
from motord_hal.fieldbus.ports import (
    BoardEncoder,
    CounterEncoder,
    DirectionKind,
    DirectionSpec,
    Echo,
    EdgesEncoder,
    JointSpec,
    LineSpec,
    Mounting,
    PinsSpec,
    TextSpec,
    TextWheel,
)


def line_specs(robot: Robot, profiles: Profiles) -> tuple[LineSpec, ...]:
    """Return one spec for each line, in the file's order; joints keep their place in the whole
    robot."""
    return tuple(
        _line_spec(robot, profiles, index, name, line)
        for index, (name, line) in enumerate(robot.line.items())
    )


def _line_spec(robot: Robot, profiles: Profiles, index: int, name: str, line: AnyLine) -> LineSpec:
    joints = tuple(
        _joint_spec(profiles, place, joint_name, joint, line)
        for place, (joint_name, joint) in enumerate(robot.joint.items())
        if joint.line == name
    )
    spec = LineSpec(
        index=index,
        name=name,
        kind=line.kind,
        port=line.address,
        baudrate=line.baudrate,
        parity=line.parity,
        stop_bits=line.stop_bits,
        cycle_hz=line.cycle_hz,
        gap_s=None,
        engine=line.engine,
        data_baudrate=line.data_bitrate if isinstance(line, CanLine) else None,
        joints=joints,
        watchdog_s=robot.safety.drive_watchdog_s,
        rest_velocity_rad_s=robot.safety.rest_velocity_rad_s,
    )
    if isinstance(robot.imu, LineImu) and robot.imu.line == name:
        mounting = Mounting(up=robot.imu.up, forward=robot.imu.forward)
        spec = replace(spec, imu=mounting)
    if isinstance(line, PwmLine):
        return _with_pins(spec, line, robot.loop.priority)
    if isinstance(line, AsciiLine):
        return replace(spec, text=_text_spec(robot, profiles, line, joints))
    if isinstance(line, CanLine):
        priority = min(line.priority, max(robot.loop.priority - 1, 0))
        return replace(spec, priority=priority, cpu=line.cpu)
    return _with_port(spec, line, robot.loop.priority) if isinstance(line, SerialLine) else spec


def _with_pins(spec: LineSpec, line: PwmLine, loop_priority: int) -> LineSpec:
    pins = PinsSpec(
        pwm_chip=line.pwm_chip or "",
        gpio_chip=line.gpio_chip or "",
        pwm_hz=line.pwm_hz,
        software_pwm=line.software_pwm,
    )
    priority = min(line.priority, max(loop_priority - 1, 0))
    return replace(spec, pins=pins, priority=priority, cpu=line.cpu)


def _text_spec(
    robot: Robot, profiles: Profiles, line: AsciiLine, joints: tuple[JointSpec, ...]
) -> TextSpec:
    def wheel(name: str) -> TextWheel:
        joint = robot.joint[name]
        return TextWheel(
            side=-1.0 if side_of(robot.base, joint) == "left" else 1.0,
            radius_m=robot.wheel_radius_m(name),
            counts_per_turn=counts_per_turn(joint, profiles[joint.drive]),
        )

    return TextSpec(
        setpoints=line.template,
        feedback=line.feedback or "",
        prefix=line.prefix,
        feedback_scale=line.feedback_scale,
        scale=line.scale,
        wheels={joint.name: wheel(joint.name) for joint in joints},
        track_m=robot.base.effective_track_m,
    )


def _with_port(spec: LineSpec, line: SerialLine, loop_priority: int) -> LineSpec:
    return replace(
        spec,
        gap=Gap(line.gap) if line.gap else None,
        gap_s=line.gap_s,
        direction=DirectionSpec(
            kind=DirectionKind(line.direction),
            active_high=line.direction_active_high,
            before_s=line.direction_before_s,
            after_s=line.direction_after_s,
            gpio_chip=line.direction_gpio_chip or "",
            gpio_line=line.direction_gpio_line or "",
        ),
        echo=Echo(line.echo),
        fast_sync_read=isinstance(line, DynamixelLine) and line.fast_sync_read,
        priority=min(line.priority, max(loop_priority - 1, 0)),
        cpu=line.cpu,
    )


def _encoder(
    joint: Joint, profile: DriveProfile, line: AnyLine
) -> EdgesEncoder | CounterEncoder | BoardEncoder | None:
    encoder, per_count = joint.encoder, rad_per_count(joint, profile)
    if encoder is None:
        return None
    if encoder.kind == "counter":
        return CounterEncoder(counter=encoder.counter, count=encoder.count, rad_per_count=per_count)
    if encoder.kind == "mcu":
        return BoardEncoder(
            port=encoder.port,
            baudrate=encoder.baudrate,
            motor=encoder.motor,
            rad_per_count=per_count,
        )
    chip = encoder.gpio_chip or (line.gpio_chip if isinstance(line, PwmLine) else None)
    return EdgesEncoder(
        gpio_chip=chip or "", a=encoder.a, b=encoder.b, pull=encoder.pull, rad_per_count=per_count
    )


def _position_velocity_rad_s(joint: Joint, profile: DriveProfile) -> float:
    """Return the speed to which the core limits the set-point's motion; 0 for a joint that takes no
    positions."""
    return velocity_range_rad_s(joint, profile)[1] if takes_position(joint, profile) else 0.0


def _joint_spec(
    profiles: Profiles, index: int, name: str, joint: Joint, line: AnyLine
) -> JointSpec:
    profile = profiles[joint.drive]
    own_counts = counts_per_turn(joint, profile)
    return JointSpec(
        index=index,
        name=name,
        profile=profile,
        unit=joint.unit,
        channel=joint.channel,
        gear_ratio=joint.gear_ratio,
        counts_per_turn=own_counts if takes_position(joint, profile) else 0,
        zero_count=joint.zero_count,
        position_min_rad=joint.position_min_rad or 0.0,
        position_max_rad=joint.position_max_rad or 0.0,
        position_velocity_rad_s=_position_velocity_rad_s(joint, profile),
        inverted=joint.inverted,
        cycle_hz=joint.cycle_hz,
        identity=joint.identity,
        pins=joint.pins,
        encoder=_encoder(joint, profile, line),
        tries=joint.tries,
        reply_timeout_s=joint.reply_timeout_s,
    )
