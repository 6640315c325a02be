# SPDX-License-Identifier: Apache-2.0
"""Checks between the frames and signals of a drive profile on a CAN bus."""

from __future__ import annotations

from itertools import combinations

from motord.config.drives.problems import Problems
from motord_hal.base.nearest import did_you_mean
from motord_hal.drives.can_profile import (
    EXTENDED_ID_MAX,
    STANDARD_ID_MAX,
    CanTable,
    Frame,
    Sender,
    Signal,
    signals_of,
)
from motord_hal.drives.profile import DriveProfile, Register


def check_can(profile: DriveProfile, table: CanTable, problems: Problems) -> None:
    """Add a problem for everything that does not fit together."""
    if not table.node_min <= profile.unit <= table.node_max:
        problems.add("can.node", f"{profile.unit} is not {table.node_min} to {table.node_max}")
    for frame in table.frames.values():
        _check_frame(table, frame, problems)
    for one, other in combinations(table.frames_from(Sender.DRIVE), 2):
        if one.base == other.base and _same_beginning(one, other):
            problems.add(f"frame.{other.name}.id", f"cannot be distinguished from frame {one.name}")
    _check_senders(table, problems)
    for signal in profile.registers.values():
        if isinstance(signal, Signal) and signal.frame:
            _check_signal(table.frames[signal.frame], signal, problems)
            _check_reply(table, signal, problems)
            _check_object(profile, signal, problems)
    for name in table.frames:
        _check_overlaps(name, signals_of(profile.registers, name), problems)
    if table.hello and "r" not in getattr(profile.registers.get(table.hello), "access", ""):
        problems.add("can.hello", f'"{table.hello}" is not a signal that can be read')
    sync = table.frames.get(table.sync)
    if sync and (sync.sender is not Sender.MOTORD or sync.addressed):
        problems.add("can.sync", f'"{sync.name}" must be sent by motord, with addressed = false')
    for channel in profile.channels.values():
        _check_rest(profile.registers.get(channel.setpoint), problems)
    _check_presence(profile, table, problems)


def _check_senders(table: CanTable, problems: Problems) -> None:
    """Check that each identifier has one sender: two that send it at once destroy both frames."""
    node = table.node_min
    for sent in table.frames_from(Sender.MOTORD):
        for received in table.frames_from(Sender.DRIVE):
            ends = [(one.identifier(node), one.is_extended(node)) for one in (sent, received)]
            if ends[0] == ends[1]:
                text = f"is sent by motord ({sent.name}) and by the drive ({received.name})"
                problems.add(f"frame.{sent.name}.id", text)


def _check_rest(setpoint: Register | None, problems: Problems) -> None:
    """Check that raw 0 of a set-point is rest, and that it is the default."""
    if isinstance(setpoint, Signal) and (setpoint.offset or setpoint.default):
        problems.add(f"signal.{setpoint.name}", "is a set-point: its offset and default must be 0")


def _same_beginning(one: Frame, other: Frame) -> bool:
    """Return whether no byte differs between the beginnings of two frames."""
    pairs = enumerate(zip(one.begins, other.begins, strict=False))
    return not any(
        mine != theirs and at not in one.open_at | other.open_at for at, (mine, theirs) in pairs
    )


def _check_frame(table: CanTable, frame: Frame, problems: Problems) -> None:
    key = f"frame.{frame.name}"
    most = EXTENDED_ID_MAX if frame.extended else STANDARD_ID_MAX
    if frame.identifier(table.node_max) > most:
        problems.add(f"{key}.id", f"with node {table.node_max} it is beyond {most:#x}")
    if len(frame.begins) > frame.size_bytes:
        problems.add(f"{key}.begins", f"is longer than the frame ({frame.size_bytes} bytes)")
    if frame.sender is Sender.MOTORD:
        for name in ("ask", "answers", "period_s", "silence_s"):
            if getattr(frame, name):
                problems.add(f"{key}.{name}", "is only for frames of the drive")
        return
    if frame.answers:
        _check_asking(table, frame, "answers", frame.answers, problems)
    if frame.ask and frame.ask != "rtr":
        _check_asking(table, frame, "ask", frame.ask, problems)
    if frame.ask == "rtr" and frame.fd:
        problems.add(f"{key}.ask", "CAN FD has no remote frames (ISO 11898-1, 8.4.2.5)")
    if frame.silence_s and frame.silence_s < 2 * frame.period_s:
        problems.add(f"{key}.silence_s", "is shorter than two periods: allow one lost frame")


def _check_asking(table: CanTable, frame: Frame, key: str, name: str, problems: Problems) -> None:
    asking = table.frames.get(name)
    if asking is None or asking.sender is not Sender.MOTORD:
        hint = did_you_mean(name, table.frames)
        problem = f'"{name}" is not a frame that motord sends{hint}'
        problems.add(f"frame.{frame.name}.{key}", problem)


def _check_signal(frame: Frame, signal: Signal, problems: Problems) -> None:
    key = f"signal.{signal.name}"
    if signal.start_bit + signal.length > 8 * frame.size_bytes:
        problems.add(
            f"{key}.start_bit", f"reaches beyond the {frame.size_bytes} bytes of {frame.name}"
        )
    if signal.scale == 0:
        problems.add(f"{key}.scale", "must not be zero")
    if signal.offset and signal.unit == "count":
        problems.add(f"{key}.offset", "is not for a counter, which is read as it stands")
    if signal.is_float and signal.length != 32:
        problems.add(f"{key}.length", "a floating-point number has 32 bits")
    low, high = signal.raw_range
    if not low <= signal.default <= high:
        problems.add(f"{key}.default", f"{signal.default} does not fit {signal.length} bits")
    least, most = signal.minimum, signal.maximum
    if least is not None and most is not None and least > most:
        problems.add(f"{key}.minimum", "is above maximum")


def _check_reply(table: CanTable, signal: Signal, problems: Problems) -> None:
    """Check that a signal that is written and read has one place in both frames."""
    reply = table.frames.get(signal.reply_frame)
    if reply is None:
        return
    key = f"signal.{signal.name}.reply"
    if reply.sender is not Sender.DRIVE or table.frames[signal.frame].sender is Sender.DRIVE:
        problems.add(key, "is the drive's frame for a signal that motord sends")
    if signal.start_bit + signal.length > 8 * reply.size_bytes:
        problems.add(key, f"{signal.name} reaches beyond the {reply.size_bytes} bytes of it")


def _check_object(profile: DriveProfile, signal: Signal, problems: Problems) -> None:
    """Check the object that is read instead of a signal: the same raw value must mean the same."""
    if not signal.object:
        return
    key, found = f"signal.{signal.name}.object", profile.registers.get(signal.object)
    if found is None or "r" not in found.access:
        hint = did_you_mean(signal.object, profile.registers)
        problems.add(key, f'"{signal.object}" cannot be read{hint}')
    elif (found.type, found.scale, found.unit) != (signal.type, signal.scale, signal.unit):
        problems.add(key, f"{signal.object} has another type, scale or unit than {signal.name}")


def _check_overlaps(frame: str, signals: tuple[Signal, ...], problems: Problems) -> None:
    for one, other in combinations(signals, 2):
        if one.big_endian != other.big_endian:
            continue  # bits are counted in another order
        if one.start_bit + one.length > other.start_bit:
            problems.add(f"signal.{other.name}.start_bit", f"overlaps {one.name} in frame {frame}")


def _check_presence(profile: DriveProfile, table: CanTable, problems: Problems) -> None:
    """Check that the feedback by which a wheel is judged comes by itself or on request, and that
    its absence is noticed."""
    if not any(frame.silence_s for frame in table.frames.values()):
        problems.add("frame", "no frame has a silence_s: nothing shows that the drive is there")
    wanted = [profile.enabled.register] if profile.enabled else []
    for channel in profile.channels.values():
        wanted += [name for name in (channel.position, channel.velocity, channel.fault) if name]
    for name in dict.fromkeys(wanted):
        signal = profile.registers.get(name)
        frame = table.frames.get(signal.frame) if isinstance(signal, Signal) else None
        if frame is None or frame.sender is not Sender.DRIVE:
            continue
        if not frame.silence_s:
            problems.add(f"frame.{frame.name}.silence_s", f"is missing: {name} comes in it")
        if not frame.period_s and not frame.ask:
            problems.add(
                f"frame.{frame.name}",
                "has neither period_s (the drive sends it) nor ask (motord requests it)",
            )
