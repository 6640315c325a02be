# SPDX-License-Identifier: Apache-2.0
"""Makes the table for the thread of a CAN line in C from the drives on it. The table consists of
plain values with the names of csrc/api/line/api_can.h. Pure.

Signs, gears and units are those of `motord_hal.can.plan`, with which the asyncio engine computes at
each frame; here they become one factor for each number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from motord_hal.can.identifiers import Sending, sendings
from motord_hal.can.job_step import merged_writes
from motord_hal.can.plan import SLOW_EVERY_CYCLES, CanPlan, Sent
from motord_hal.drives.can_profile import FLOAT_MAX, Frame, Sender, Signal, signals_of
from motord_hal.drives.profile import SI_UNITS, Enabled, Handshake, Step
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.realtime.can import EXTENDED, REMOTE
from motord_hal.realtime.table import FieldKind
from motord_hal.rt_engine.decoding import harmless_words, setpoint_scale, sources_of, wheel_factor

SAMPLE_PART = 0.5
"""Least distance of two samples as a part of their period. The thread ignores a sample that follows
sooner, because the CAN bus has delayed the one before (the same rule as in the asyncio engine)."""
_NS_PER_S = 1e9
_U32 = 0xFFFF_FFFF

Plain = dict[str, Any]


def can_table(spec: LineSpec, plans: Sequence[CanPlan]) -> Plain:
    """Return the table of a CAN line. C checks it once more and names the first bad field."""
    syncs = list(dict.fromkeys(plan.sync for plan in plans if plan.sync))
    sending = [raw_identifier(one) for one in table_sendings(plans)]
    return {
        "sending_count": len(sending),
        "sending": sending,
        "sync_count": len(syncs),
        "sync": [packet(sync) for sync in syncs],
        "drive_count": len(plans),
        "period_ns": round(_NS_PER_S / spec.cycle_hz),
        "setpoint_timeout_ns": round(spec.setpoint_timeout_s * _NS_PER_S),
        "rest_velocity_rad_s": spec.rest_velocity_rad_s,
        "drive": [drive_table(plan, spec) for plan in plans],
    }


def table_sendings(plans: Sequence[CanPlan]) -> list[Sending]:
    """Return the identifiers that motord sends, in the order of the table."""
    return sorted(sendings(plans), key=raw_identifier)


def raw_identifier(sending: Sending) -> int:
    """Return the identifier with its flag bits."""
    return sending.identifier | EXTENDED * sending.extended | REMOTE * sending.remote


def inputs_of(plan: CanPlan) -> tuple[Frame, ...]:
    """Return the frames of the drive that the cycle uses, in the order of the table."""
    hello = () if plan.hello is None else (plan.hello,)
    return tuple(dict.fromkeys((*plan.fast, *plan.slow, *plan.watched, *hello)))


def drive_table(plan: CanPlan, spec: LineSpec) -> Plain:
    """Return the entry of one drive in the table of its line."""
    inputs = inputs_of(plan)
    probes = plan.probed if plan.hello is None else (plan.hello,)
    parts: dict[str, list[Plain]] = {
        "output": [_output(plan, frame) for frame in plan.setpoint_frames],
        "poll": list(_questions(plan, plan.asked_fast)),
        "slow": list(_questions(plan, plan.asked_slow)),
        "probe": list(_questions(plan, probes)),
        "match": list(_matches(plan, inputs)),
        "input": [_input(plan, spec, frame) for frame in inputs],
        "quick_stop": _step_writes(plan, plan.profile.quick_stop),
        "disarm": _step_writes(plan, plan.profile.disarm),
    }
    return {
        "tries": max(joint.tries for joint in plan.joints),
        "slow_every": SLOW_EVERY_CYCLES,
        "idle_setpoints": int(plan.table.idle_setpoints),
        "reports_enabled": int(plan.profile.enabled is not None),
        "hello": 0 if plan.hello is None else 1 + inputs.index(plan.hello),
        "watchdog_ns": round(spec.watchdog_s * _NS_PER_S),
        **parts,
        **{f"{name}_count": len(part) for name, part in parts.items()},
    }


# -------------------------------------------------------------------------------------- sent frames
def packet(sent: Sent) -> Plain:
    """Return a frame as the struct can_packet."""
    remote = REMOTE if sent.remote_bytes is not None else 0
    size_bytes = len(sent.data) if sent.remote_bytes is None else sent.remote_bytes
    return {
        "id": sent.identifier | EXTENDED * sent.extended | remote,
        "bytes": size_bytes,
        "fd": int(sent.fd),
        "data": list(sent.data),
    }


def write(plan: CanPlan, frame: Frame, raw: Mapping[str, int]) -> Plain:
    """Return the struct can_write of a frame with these signals. If the frame also carries
    set-points, the signals stay in it from then on."""
    plain: Plain = {"packet": packet(plan.write(frame, raw))}
    if frame in plan.setpoint_frames:
        mask = bytearray(frame.size_bytes)
        for name in raw:
            _mark(plan.signal(name), mask)
        plain |= {"output": 1 + plan.setpoint_frames.index(frame), "mask": list(mask)}
    return plain


def _mark(signal: Signal, mask: bytearray) -> None:
    low, high = signal.raw_range
    signal.insert(mask, -1 if low < 0 else high)


def _step_writes(plan: CanPlan, steps: Iterable[Step]) -> list[Plain]:
    """Return the writes of a sequence, in order, without its waits."""
    return [write(plan, frame, raw) for frame, raw in merged_writes(plan, steps)]


def _questions(plan: CanPlan, frames: Iterable[Frame]) -> Iterator[Plain]:
    for frame in frames:
        question = plan.question(frame)
        if question is not None and question != plan.sync:  # the cycle sends a sync
            yield packet(question)


def _place(signal: Signal) -> Plain:
    form = 2 if signal.is_float else int(signal.type.signed)
    return {
        "start_bit": signal.start_bit,
        "length": signal.length,
        "big_endian": int(signal.big_endian),
        "form": form,
    }


def _si_per_raw(signal: Signal) -> float:
    return signal.scale * SI_UNITS[signal.unit][1]


def _output(plan: CanPlan, frame: Frame) -> Plain:
    setpoints = list(_setpoints(plan, frame))
    return {
        "packet": packet(plan.write(frame, {})),
        "setpoint_count": len(setpoints),
        "setpoint": setpoints,
    }


def _setpoints(plan: CanPlan, frame: Frame) -> Iterator[Plain]:
    for joint in plan.joints:
        channel = plan.channel(joint)
        signal = plan.signal(channel.setpoint)
        if plan.frame_of(signal.name) is not frame:
            continue
        scale = setpoint_scale(joint, channel, _si_per_raw(signal), _raw_limits(signal))
        trigger = _trigger(plan, channel.handshake)
        yield {"place": _place(signal), "scale": scale, "trigger": trigger}


def _trigger(plan: CanPlan, handshake: Handshake | None) -> Plain:
    """Return the bit that makes the drive take a target; empty: it takes every target."""
    if handshake is None:
        return {}
    signal, place = plan.signal(handshake.register), handshake.mask.bit_length() - 1
    if signal.big_endian:
        place = signal.length - 1 - place
    return {
        "start_bit": signal.start_bit + place,
        "length": 1,
        "big_endian": int(signal.big_endian),
        "form": 0,
    }


def _raw_limits(signal: Signal) -> tuple[float, float]:
    """Return the least and greatest raw value, from the limits of the signal and of its type, as
    Signal.from_si applies them."""
    ends = sorted(limit / _si_per_raw(signal) for limit in signal.si_limits)
    least, most = (-FLOAT_MAX, FLOAT_MAX) if signal.is_float else map(float, signal.raw_range)
    return max(ends[0], least), min(ends[1], most)


# --------------------------------------------------------------------------------- received frames
def _matches(plan: CanPlan, inputs: Sequence[Frame]) -> Iterator[Plain]:
    """Yield the matches that recognise the drive's frames. Replies about objects that the cycle
    does not use go to Python, which decodes them: one match covers them all, after the other
    matches of their identifier."""
    reply = plan.table.frames.get(plan.table.abort)
    for frame in plan.table.frames_from(Sender.DRIVE):
        if reply is None or frame in inputs or frame.base != reply.base:
            yield _match(plan, frame, inputs)
    if reply is not None:
        yield _match(plan, replace(reply, begins=b""), inputs)


def _match(plan: CanPlan, frame: Frame, inputs: Sequence[Frame]) -> Plain:
    return {
        "id": frame.identifier(plan.node) | EXTENDED * frame.is_extended(plan.node),
        "bytes": frame.size_bytes,
        "begins_bytes": len(frame.begins),
        "begins": list(frame.begins),
        "begins_mask": list(_sent_by(frame)),
        "input": 1 + inputs.index(frame) if frame in inputs else 0,
    }


def _sent_by(frame: Frame) -> Iterator[int]:
    """Yield for each of a frame's first bytes the mask of the bits that identify the frame: those
    in which all beginnings of the frame agree."""
    for at, (one, other) in enumerate(
        zip(frame.begins, frame.or_begins or frame.begins, strict=True)
    ):
        yield 0 if at in frame.open_at else 0xFF & ~(one ^ other)


def silence_s(plan: CanPlan, spec: LineSpec, frame: Frame) -> float:
    """Return the time without this frame after which a drive is unresponsive; 0: never."""
    if frame not in plan.watched:
        return 0.0
    if frame.period_s:
        return frame.silence_s
    tries = max(joint.tries for joint in plan.joints)
    return max(frame.silence_s, tries / spec.cycle_hz + plan.profile.turnaround_s)


def _input(plan: CanPlan, spec: LineSpec, frame: Frame) -> Plain:
    fields = [*_joint_fields(plan, frame), *_enabled_field(plan, frame)]
    fields += [*_homed(plan, frame), *_taken(plan, frame)]
    spacing_s = SAMPLE_PART * frame.period_s if frame in plan.measuring else 0.0
    return {
        "silence_ns": round(silence_s(plan, spec, frame) * _NS_PER_S),
        "spacing_ns": round(spacing_s * _NS_PER_S),
        "fast": int(frame in plan.fast),
        "field_count": len(fields),
        "field": fields,
    }


def _signals(plan: CanPlan, frame: Frame) -> dict[str, Signal]:
    return {one.name: one for one in signals_of(plan.profile.registers, frame.name)}


def _joint_fields(plan: CanPlan, frame: Frame) -> Iterator[Plain]:
    found = _signals(plan, frame)
    for joint in plan.joints:
        channel = plan.channel(joint)
        for kind, name in sources_of(plan.profile, channel):
            if name in found and plan.read_frame_of(name) is frame:
                yield _joint_field(plan, joint, kind, found[name])


def _joint_field(plan: CanPlan, joint: JointSpec, kind: FieldKind, signal: Signal) -> Plain:
    profile = plan.profile
    meaning: Plain = {"joint": joint.index, "kind": int(kind)}
    factor, at_zero = _si_per_raw(signal), signal.offset * SI_UNITS[signal.unit][1]
    if kind is FieldKind.COUNT:
        counted = signal.unit == "count"
        per_si = profile.counts_per_turn / (2.0 * math.pi)
        factor, at_zero = (1.0, 0.0) if counted else (factor * per_si, at_zero * per_si)
        meaning["counter_bits"] = profile.counter_bits
    elif kind is FieldKind.FAULT:
        meaning |= harmless_words(profile)
    else:
        own = wheel_factor(joint, kind)
        factor, at_zero = factor * own, at_zero * own
    meaning["si_per_raw"] = factor
    return {"place": _place(signal), "meaning": meaning, "si_at_zero": at_zero}


def _enabled_field(plan: CanPlan, frame: Frame) -> Iterator[Plain]:
    enabled_place = plan.profile.enabled
    if enabled_place is not None and plan.read_frame_of(enabled_place.register) is frame:
        yield _is_so(plan, FieldKind.ENABLED, 0, enabled_place)


def _homed(plan: CanPlan, frame: Frame) -> Iterator[Plain]:
    homed = plan.profile.homed
    if homed is not None and plan.read_frame_of(homed.register) is frame:
        for joint in plan.joints:
            yield _is_so(plan, FieldKind.REFERENCED, joint.index, homed)


def _taken(plan: CanPlan, frame: Frame) -> Iterator[Plain]:
    for joint in plan.joints:
        handshake = plan.channel(joint).handshake
        if handshake is not None and plan.read_frame_of(handshake.acknowledged) is frame:
            mask = handshake.acknowledged_mask
            place = Enabled(register=handshake.acknowledged, mask=mask, equals=mask)
            yield _is_so(plan, FieldKind.TAKEN, joint.index, place)


def _is_so(plan: CanPlan, kind: FieldKind, joint: int, place: Enabled) -> Plain:
    return {
        "place": _place(plan.signal(place.register)),
        "meaning": {
            "joint": joint,
            "kind": int(kind),
            "si_per_raw": 1.0,
            "equals_mask": place.mask & _U32,
            "equals": place.equals & _U32,
        },
        "si_at_zero": 0.0,
    }
