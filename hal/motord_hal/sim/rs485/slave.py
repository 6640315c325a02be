# SPDX-License-Identifier: Apache-2.0
"""All units of one line as one function, from a frame to the answer or None."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from motord_hal.ddsm import codec as ddsm
from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    FrameError,
    Function,
    build_exception,
    build_reply,
    parse_request,
)
from motord_hal.roboclaw import codec as roboclaw
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.registers import ILLEGAL_FUNCTION, ILLEGAL_VALUE, Refusal

_KNOWN = frozenset(Function)
_READS = (Function.READ_HOLDING, Function.READ_INPUT, Function.READ_WRITE)


@dataclass(frozen=True, slots=True)
class Answer:
    drive: SimulatedDrive
    frame: bytes


def answer(frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float) -> Answer | None:
    """Carry out a whole frame with a good CRC. Return None if no unit answers: it is a broadcast,
    or its unit is absent or without power."""
    unit, function = frame[0], frame[1]
    if unit == BROADCAST_UNIT:
        _broadcast(frame, drives, now_s)
        return None
    drive = drives.get(unit)
    if drive is None or not drive.on:
        return None
    try:
        request = parse_request(frame)
        return Answer(drive, build_reply(request, drive.execute(request, now_s)))
    except Refusal as refusal:
        return Answer(drive, build_exception(unit, function, refusal.code))
    except FrameError:
        code = ILLEGAL_VALUE if function in _KNOWN else ILLEGAL_FUNCTION
        return Answer(drive, build_exception(unit, function, code))


def _broadcast(frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float) -> None:
    """Carry out a write on all units, without an answer, even if refused: Serial Line V1.02,
    2.1."""
    try:
        request = parse_request(frame)
    except FrameError:
        return
    if request.function in _READS:
        return
    for drive in drives.values():
        if drive.on:
            try:
                drive.execute(request, now_s)
            except Refusal:
                continue


def answer_ddsm(frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float) -> Answer | None:
    """Carry out a good frame of DDSM motors, which refuse nothing: they ignore unknown commands."""
    drive = drives.get(frame[0])
    if drive is None or not drive.on:
        return None
    reply = drive.execute_ddsm(frame, now_s)
    return None if reply is None or not ddsm.is_answered(frame[1]) else Answer(drive, reply)


def answer_roboclaw(
    packet: bytes, drives: Mapping[int, SimulatedDrive], now_s: float
) -> Answer | None:
    """Carry out a good packet on the controllers, which ignore unknown commands."""
    drive = drives.get(packet[0])
    if drive is None or not drive.on:
        return None
    try:
        words = drive.execute(roboclaw.parse_packet(packet), now_s)
    except Refusal:
        return None
    return Answer(drive, roboclaw.build_reply(packet, words))
