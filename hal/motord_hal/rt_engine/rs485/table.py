# SPDX-License-Identifier: Apache-2.0
"""Makes the table for the thread of a serial line in C from the drives on the line. Pure.

Signs, gears and units are those of `motord_hal.modbus.plan`, with which the asyncio engine computes
in each cycle; here they become one factor for each number.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from motord_hal.drives.profile import SI_UNITS, DriveProfile, Register, Step
from motord_hal.fieldbus.job import configure_steps, kept_steps, watchdog_time_s
from motord_hal.fieldbus.ports import Echo, JointSpec, LineSpec
from motord_hal.fieldbus.positions import raw_offset, raw_per_rad, raw_per_s
from motord_hal.modbus.codec import character_bits
from motord_hal.modbus.plan import EXTRA_EVERY_CYCLES
from motord_hal.modbus.timing import LATE_PTY_S, LATE_UART_S, line_gap_s
from motord_hal.realtime.table import (
    NO_GROUP,
    FieldKind,
    Form,
    LineDirection,
    LineDrive,
    LineExchange,
    LineField,
    LineFrame,
    LineGroup,
    LineSetpoint,
    LineTable,
)
from motord_hal.rt_engine.decoding import (
    harmless,
    setpoint_kind,
    sources_of,
    wheel_factor,
)
from motord_hal.rt_engine.rs485.frames import DriveFrames, PlannedFrame
from motord_hal.rt_engine.rs485.servo_frames import EXTRA_EVERY_CYCLES as SERVO_EXTRA_EVERY
from motord_hal.rt_engine.rs485.servo_frames import ServoFrames, group_of
from motord_hal.servo.packets import KINDS as SERVO_KINDS

_NS_PER_S = 1e9
_U32 = 0xFFFF_FFFF
_FORMS = MappingProxyType({form.name.lower().replace("_", "-"): form for form in Form})
_ECHO = MappingProxyType({Echo.NO: 0, Echo.YES: 1, Echo.AUTO: 2})


def line_table(spec: LineSpec, drives: Sequence[DriveFrames]) -> LineTable:
    """Return the table of a line. C checks it once more and names the first bad field."""
    bits = character_bits(spec.parity, spec.stop_bits)
    return LineTable(
        echo=0 if spec.kind == "roboclaw" else _ECHO[spec.echo],  # a RoboClaw's line has no echo
        character_ns=bits * _NS_PER_S / spec.baudrate,
        gap_ns=round(line_gap_s(spec) * _NS_PER_S),
        late_ns=late_ns(is_pty=True),  # the longest; the open port shows which it is
        setpoint_timeout_ns=round(spec.setpoint_timeout_s * _NS_PER_S),
        rest_velocity_rad_s=spec.rest_velocity_rad_s,
        broadcast_stop=_broadcast_stop(drives),
        group=_group(spec, drives),
        drive=tuple(drive_table(frames, spec) for frames in drives),
    )


def late_ns(*, is_pty: bool) -> int:
    """Return the time after a request in which its reply may come late: `line_table.late_ns`."""
    return round((LATE_PTY_S if is_pty else LATE_UART_S) * _NS_PER_S)


def _group(spec: LineSpec, drives: Sequence[DriveFrames]) -> LineGroup:
    servos = [frames for frames in drives if isinstance(frames, ServoFrames)]
    group = group_of(servos) if servos else None
    return NO_GROUP if group is None else replace(group, fast=int(spec.fast_sync_read))


def _broadcast_stop(drives: Sequence[DriveFrames]) -> tuple[LineFrame, ...]:
    """Return the frames that stop all drives at once; empty unless all drives have the same
    profile, because the register that stops one drive may mean something else to another."""
    first = drives[0]
    alike = all(frames.profile.name == first.profile.name for frames in drives)
    if not alike or not first.profile.broadcast_stop:
        return ()
    return tuple(
        frame
        for step in first.profile.quick_stop
        if step.value is not None
        for frame in first.broadcasts({step.register: step.value})
    )


def drive_table(frames: DriveFrames, spec: LineSpec) -> LineDrive:
    """Return the entry of one drive in the table of its line."""
    profile, joints = frames.profile, frames.joints
    rates_hz = [joint.cycle_hz for joint in joints if joint.cycle_hz is not None]
    given_s = [joint.reply_timeout_s for joint in joints if joint.reply_timeout_s is not None]
    watchdog_s = watchdog_time_s(profile, spec.watchdog_s) if profile.watchdog else 0.0
    kept = kept_steps(configure_steps(profile, spec.watchdog_s))
    cyclic = frames.cyclic()
    return LineDrive(
        tries=max(joint.tries for joint in joints),
        extra_every=SERVO_EXTRA_EVERY if isinstance(frames, ServoFrames) else EXTRA_EVERY_CYCLES,
        period_ns=round(_NS_PER_S / max(rates_hz, default=spec.cycle_hz)),
        turnaround_ns=round(profile.turnaround_s * _NS_PER_S),
        reply_timeout_ns=round(max(given_s, default=0.0) * _NS_PER_S),
        watchdog_ns=round(watchdog_s * _NS_PER_S),
        probe=_probe(cyclic),
        cyclic=tuple(_exchange(frames, planned, kept) for planned in cyclic),
        extra=tuple(_exchange(frames, planned, kept) for planned in _extra(frames)),
        direction=tuple(_directions(frames)),
        quick_stop=step_frames(frames, profile.quick_stop),
        disarm=step_frames(frames, profile.disarm),
        idle=frames.idle(),
    )


def step_frames(frames: DriveFrames, steps: Iterable[Step]) -> tuple[LineFrame, ...]:
    """Return the writes of a sequence, in order, without its waits."""
    return tuple(
        frame
        for step in steps
        if step.value is not None
        for frame in frames.writes({step.register: step.value})
    )


def _probe(cyclic: Sequence[PlannedFrame]) -> int:
    """Return 1 + the number of the first exchange that only reads, to poll an unresponsive drive;
    0: no exchange only reads, and C selects one."""
    return next((n for n, planned in enumerate(cyclic, 1) if not planned.writes), 0)


def _extra(frames: DriveFrames) -> list[PlannedFrame]:
    """Return the extra exchanges, the one with the enabled state first."""
    place = frames.profile.enabled
    return sorted(frames.extra(), key=lambda p: place is None or place.register not in p.reads)


def _exchange(frames: DriveFrames, planned: PlannedFrame, kept: tuple[Step, ...]) -> LineExchange:
    return LineExchange(
        frame=planned.frame,
        setpoint=tuple(_setpoints(frames, planned.writes)),
        field=(
            *_joint_fields(frames, planned.reads),
            *_drive_fields(frames, planned.reads, kept),
        ),
    )


# --------------------------------------------------------------------------------- sent set-points
def _setpoints(frames: DriveFrames, places: Mapping[str, int]) -> Iterable[LineSetpoint]:
    for joint in frames.joints:
        channel = frames.profile.channels[joint.channel]
        name = channel.setpoint
        if name not in places:
            continue
        register = frames.profile.registers[name]
        magnitude = channel.direction is not None
        sign = 1.0 if magnitude else joint.sign
        low, high = raw_limits(register)
        factor = sign * channel.to_motor(joint.gear_ratio) / si_per_raw(register)
        if channel.position_setpoint is not None:
            factor = raw_per_rad(joint, frames.profile)
        yield LineSetpoint(
            joint=joint.index,
            kind=setpoint_kind(channel),
            byte=places[name],
            form=form_of(frames.profile, register),
            magnitude=int(magnitude),
            raw_per_si=factor,
            raw_offset=raw_offset(joint, frames.profile),
            raw_min=low,
            raw_max=high,
            raw_per_s=raw_per_s(joint, frames.profile),
        )


def form_of(profile: DriveProfile, register: Register, *, signed: bool = True) -> Form:
    """Return the form of the register's value in the drive's frames."""
    name = register.type.value
    if not signed and name.startswith("i"):
        name = f"u{name[1:]}"
    if register.type.high_first:
        return _FORMS[name.removesuffix("-high-first")]
    low_byte_first = profile.protocol in SERVO_KINDS and register.type.bits > 8
    return _FORMS[f"{name}-le" if low_byte_first else name]


def si_per_raw(register: Register) -> float:
    return register.scale * SI_UNITS[register.unit][1]


def raw_limits(register: Register) -> tuple[float, float]:
    """Return the least and greatest raw value, from the limits of the register and of its type, as
    Register.from_si applies them."""
    low, high = register.raw_range
    given = (register.minimum, register.maximum)
    scaled = [None if limit is None else limit / register.scale for limit in given]
    if register.scale < 0:
        scaled.reverse()
    least, most = scaled
    return (
        float(low) if least is None else min(max(least, low), high),
        float(high) if most is None else min(max(most, low), high),
    )


def _direction_joints(frames: DriveFrames) -> list[JointSpec]:
    channels = frames.profile.channels
    return [joint for joint in frames.joints if channels[joint.channel].direction is not None]


def _directions(frames: DriveFrames) -> Iterable[LineDirection]:
    for joint in _direction_joints(frames):
        channel = frames.profile.channels[joint.channel]
        direction = channel.direction
        assert direction is not None  # _direction_joints has checked it
        levels = (direction.rest, direction.forward, direction.reverse)
        rest, forward, reverse = (frames.writes({direction.register: raw})[0] for raw in levels)
        yield LineDirection(
            joint=joint.index,
            kind=setpoint_kind(channel),
            inverted=int(joint.inverted),
            rest=rest,
            forward=forward,
            reverse=reverse,
        )


# -------------------------------------------------------------------------------- received feedback
def _joint_fields(frames: DriveFrames, places: Mapping[str, int]) -> Iterable[LineField]:
    profile = frames.profile
    for joint in frames.joints:
        channel = profile.channels[joint.channel]
        for kind, name in sources_of(profile, channel):
            if name in places:
                yield _joint_field(frames, joint, kind, profile.registers[name], places[name])


def _joint_field(
    frames: DriveFrames, joint: JointSpec, kind: FieldKind, register: Register, byte: int
) -> LineField:
    form, mask = form_of(frames.profile, register), register.mask or 0
    factor, direction = si_per_raw(register) * wheel_factor(joint, kind), 0
    if kind is FieldKind.COUNT:
        form, mask = _counter(register, frames.profile)
    elif kind is FieldKind.VELOCITY:
        joints = _direction_joints(frames)
        if not register.type.signed and joint in joints:
            direction = 1 + joints.index(joint)
    bits, codes = harmless(frames.profile) if kind is FieldKind.FAULT else (0, None)
    return LineField(
        joint=joint.index,
        kind=kind,
        byte=byte,
        form=form,
        mask=mask,
        direction=direction,
        si_per_raw=factor,
        harmless_bits=bits,
        is_code=int(codes is not None),
        harmless=codes or (),
    )


def _counter(register: Register, profile: DriveProfile) -> tuple[Form, int]:
    """Return the form and mask of a position counter. The core gets it unsigned, and only the bits
    that count."""
    form, bits = form_of(profile, register, signed=False), profile.counter_bits
    whole = (1 << form.bits) - 1
    mask = register.mask or whole
    low = mask & -mask
    counted = mask & (low * ((1 << bits) - 1))
    return form, 0 if counted == whole else counted


def _drive_fields(
    frames: DriveFrames, places: Mapping[str, int], kept: tuple[Step, ...]
) -> Iterable[LineField]:
    profile = frames.profile
    place, homed = profile.enabled, profile.homed
    wanted = [(FieldKind.KEPT, 0, step.register, step.mask, step.equals or 0) for step in kept]
    if place is not None:
        wanted.append((FieldKind.ENABLED, 0, place.register, place.mask, place.equals))
    if homed is not None:
        referenced = (homed.register, homed.mask, homed.equals)
        wanted += [(FieldKind.REFERENCED, joint.index, *referenced) for joint in frames.joints]
    for kind, joint, name, mask, equals in wanted:
        if name in places:
            register = profile.registers[name]
            yield LineField(
                joint=joint,
                kind=kind,
                byte=places[name],
                form=form_of(profile, register),
                mask=register.mask or 0,
                equals_mask=mask & _U32,
                equals=equals & _U32,
            )
