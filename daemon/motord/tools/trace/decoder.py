# SPDX-License-Identifier: Apache-2.0
"""Describes exchanges in words, with the profiles of the drives on a line."""

from __future__ import annotations

from motord.config import Robot
from motord.tools.trace.boards import board_decoder, registers_words
from motord.tools.trace.exchanges import Exchange, Words
from motord_hal.can.codec import parse
from motord_hal.can.socket_frames import unpacked
from motord_hal.drives.can_profile import Sender, signals_of
from motord_hal.drives.profile import DriveProfile
from motord_hal.modbus.codec import (
    EXCEPTION_TEXT,
    CrcError,
    FrameError,
    Request,
    parse_reply,
    parse_request,
    seal,
)

MODBUS = ("modbus-rtu", "modbus-tcp", "rtu-over-tcp")
_MBAP_BYTES = 7
"""Length of the header of Modbus TCP: transaction, protocol, length, unit (Modbus Messaging on
TCP/IP V1.0b, 3.1.3)."""


class Decoder:
    """Decodes the exchanges of one line with the profiles of its drives."""

    def __init__(self, kind: str, robot: Robot, line: str) -> None:
        self._kind = kind
        self._board = board_decoder(kind, robot, line)
        profiles = robot.profiles
        self._drives = [
            (name, joint.unit, profiles[joint.drive])
            for name, joint in robot.joint.items()
            if joint.line == line
        ]

    def words(self, exchange: Exchange) -> Words:
        """Return the description of an exchange."""
        if self._kind == "can":
            return self._can(exchange)
        if self._kind in MODBUS:
            return self._modbus(exchange)
        if self._board is not None:
            return self._board(exchange)
        text = (exchange.sent or exchange.received).decode("ascii", "replace").strip()
        shown = text if text.isprintable() else ""
        return Words("", shown, "out" if exchange.outward else "in")

    # ----------------------------------------------------------------------------------- Modbus
    def _modbus(self, exchange: Exchange) -> Words:
        sent, received = (rtu_frame(self._kind, b) for b in (exchange.sent, exchange.received))
        try:
            request = parse_request(sent)
        except (FrameError, ValueError) as error:
            return Words("", "", f"not expected: {error}" if sent else "came without a request")
        joints = [(name, profile) for name, unit, profile in self._drives if unit == request.unit]
        names = ",".join(name for name, _ in joints) or f"unit {request.unit}"
        what = _request_words(request, joints[0][1] if joints else None)
        if not received:
            return Words(names, what, "no reply" if request.unit else "broadcast")
        try:
            reply = parse_reply(request, received)
        except CrcError:
            return Words(names, what, "bad CRC")
        except FrameError as error:
            return Words(names, what, f"bad reply: {error}")
        if reply.exception is not None:
            text = EXCEPTION_TEXT.get(reply.exception, "unknown")
            return Words(names, what, f"exception {reply.exception} ({text})")
        if reply.values:
            profile = joints[0][1] if joints else None
            what += f" → {registers_words(profile, request.address, reply.values)}"
        return Words(names, what, "ok")

    # -------------------------------------------------------------------------------------- CAN
    def _can(self, exchange: Exchange) -> Words:
        message = unpacked(exchange.sent or exchange.received, 0.0)
        end = "out" if exchange.outward else "in"
        for name, node, profile in self._drives:
            for label, frame in profile.can.frames.items() if profile.can else ():
                ours = frame.sender is not Sender.DRIVE
                named = (frame.identifier(node), frame.is_extended(node))
                if ours != exchange.outward or named != (
                    message.arbitration_id, message.is_extended_id,
                ):  # fmt: skip
                    continue
                signals = signals_of(dict(profile.registers), label)
                raw = parse(frame, signals, bytes(message.data))
                if raw is None and not message.is_remote_frame:
                    continue
                values = [f"{s.name} {s.to_si(raw[s.name]):g}" for s in signals] if raw else []
                asked = "requests " if message.is_remote_frame else ""
                return Words(name, f"{asked}{label} {', '.join(values)}".strip(), end)
        return Words("", f"{message.arbitration_id:X}", end)


def rtu_frame(kind: str, frame: bytes) -> bytes:
    """Return a frame in the form of a serial line. A frame of Modbus TCP loses its header and gets
    a check sum; other frames do not change."""
    if kind != "modbus-tcp" or len(frame) <= _MBAP_BYTES:
        return frame
    return seal(frame[_MBAP_BYTES - 1 :])


def _request_words(request: Request, profile: DriveProfile | None) -> str:
    if not request.values:
        return f"read {request.count} from {request.address:04X}h"
    address = request.write_address or request.address
    words = f"write {registers_words(profile, address, request.values)}"
    if request.count:
        words += f", read {request.count} from {request.address:04X}h"
    return words
