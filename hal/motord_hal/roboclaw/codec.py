# SPDX-License-Identifier: Apache-2.0
"""RoboClaw packet serial as pure functions. Shared by the line and the simulator.

Source: Basicmicro, RoboClaw Series User Manual, Packet Serial and Advanced Packet Serial (command
numbers are the manual's). A write is address, command, content, CRC and is answered by 0xFF; a read
is address and command alone, and is answered by content and CRC. The CRC is CRC-16/XMODEM over
address, command and content; numbers stand high byte first.

In a drive profile with `protocol = "roboclaw"` a register's address is command << 8 | word of its
content. A value that is read by one command and written by another has the address of the writing
one. Content of one byte is a word.
"""

from __future__ import annotations

from types import MappingProxyType

from motord_hal.mcu.frames import crc16
from motord_hal.modbus.codec import Function, Request

UNITS = range(0x80, 0x88)
"""Addresses that a RoboClaw can have."""
ACKNOWLEDGED = b"\xff"
CRC_BYTES = 2
DUTIES, SPEEDS = 34, 37
WRITE_BYTES = MappingProxyType({14: 1, DUTIES: 4, SPEEDS: 8})
"""Bytes of content of each writing command: 14 serial timeout, 34 both duties, 37 both speeds."""
READ_BYTES = MappingProxyType({15: 1, 24: 2, 49: 4, 78: 8, 82: 2, 90: 4, 108: 8})
"""Bytes of content of each answer: 15 serial timeout, 24 main battery, 49 both currents, 78 both
encoders, 82 temperature, 90 status, 108 both mean speeds."""
READ_BY = MappingProxyType({14: 15})
"""Writing command → command that reads the same value."""
WRITTEN_BY = MappingProxyType({reading: writing for writing, reading in READ_BY.items()})


class PacketError(ValueError):
    """Bytes that are not the expected answer, or a request that RoboClaw does not have."""


def _words(content: bytes) -> tuple[int, ...]:
    padded = content if len(content) % 2 == 0 else b"\0" + content
    return tuple(int.from_bytes(padded[at : at + 2], "big") for at in range(0, len(padded), 2))


def _content(words: tuple[int, ...], size: int) -> bytes:
    return b"".join(word.to_bytes(2, "big") for word in words)[-size:]


def _sum(unit: int, command: int, content: bytes) -> bytes:
    return crc16(bytes((unit, command)) + content, start=0).to_bytes(CRC_BYTES, "big")


def reading_command(request: Request) -> int:
    command = request.address >> 8
    return READ_BY.get(command, command)


def build(request: Request) -> bytes:
    """Return the packet for a read or write of registers. Content without a value is 0. Raises
    PacketError."""
    if request.function is Function.READ_HOLDING:
        command = reading_command(request)
        if command not in READ_BYTES:
            raise PacketError(f"command {command} is not known for reading")
        return bytes((request.unit, command))
    command, first = request.address >> 8, request.address & 0xFF
    size = WRITE_BYTES.get(command)
    if size is None:
        raise PacketError(f"command {command} is not known for writing")
    words = [0] * -(-size // 2)
    words[first : first + len(request.values)] = request.values
    content = _content(tuple(words), size)
    return bytes((request.unit, command)) + content + _sum(request.unit, command, content)


def reply_size(request: Request) -> int:
    """Return the length of the answer in bytes."""
    if request.function is not Function.READ_HOLDING:
        return len(ACKNOWLEDGED)
    return READ_BYTES[reading_command(request)] + CRC_BYTES


def parse(request: Request, reply: bytes) -> tuple[int, ...]:
    """Return the words that a read requested; none for a write. Raises PacketError."""
    if len(reply) != reply_size(request):
        raise PacketError(f"{reply.hex(' ')} is no answer of {reply_size(request)} bytes")
    if request.function is not Function.READ_HOLDING:
        if reply != ACKNOWLEDGED:
            raise PacketError(f"{reply.hex(' ')} is no acknowledgement")
        return ()
    content = reply[:-CRC_BYTES]
    if reply[-CRC_BYTES:] != _sum(request.unit, reading_command(request), content):
        raise PacketError(f"{reply.hex(' ')} has a wrong CRC")
    first = request.address & 0xFF
    return _words(content)[first : first + request.count]


# ------------------------------------------------------------------------- the controller's side
def packet_bytes(packet: bytes) -> int | None:
    """Return the length of a packet that begins so; None: too short, or an unknown command."""
    if len(packet) < 2:
        return None
    size = WRITE_BYTES.get(packet[1])
    if size is not None:
        return 2 + size + CRC_BYTES
    return 2 if packet[1] in READ_BYTES else None


def parse_packet(packet: bytes) -> Request:
    """Return the request in a whole packet. Raises PacketError."""
    if packet_bytes(packet) != len(packet):
        raise PacketError(f"{packet.hex(' ')} is no packet")
    unit, command = packet[0], packet[1]
    if command in READ_BYTES:
        count = -(-READ_BYTES[command] // 2)
        address = WRITTEN_BY.get(command, command) << 8
        return Request(unit, Function.READ_HOLDING, address, count=count)
    content = packet[2:-CRC_BYTES]
    if packet[-CRC_BYTES:] != _sum(unit, command, content):
        raise PacketError(f"{packet.hex(' ')} has a wrong CRC")
    return Request(unit, Function.WRITE_MULTIPLE, command << 8, values=_words(content))


def build_reply(packet: bytes, words: tuple[int, ...]) -> bytes:
    """Return the answer to a good packet."""
    unit, command = packet[0], packet[1]
    if command not in READ_BYTES:
        return ACKNOWLEDGED
    content = _content(words, READ_BYTES[command])
    return content + _sum(unit, command, content)
