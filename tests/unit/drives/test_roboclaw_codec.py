# SPDX-License-Identifier: Apache-2.0
"""RoboClaw packets: requests, what counts as an answer, and both sides of one codec."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.config.drives.load import find_profile
from motord_hal.modbus.codec import Function, Request
from motord_hal.roboclaw.codec import (
    ACKNOWLEDGED,
    READ_BYTES,
    WRITE_BYTES,
    PacketError,
    build,
    build_reply,
    packet_bytes,
    parse,
    parse_packet,
    reply_size,
)

UNIT = 0x80
SPEEDS = Request(UNIT, Function.WRITE_MULTIPLE, 37 << 8, values=(0, 1000, 0xFFFF, 0xFC18))
ENCODERS = Request(UNIT, Function.READ_HOLDING, 78 << 8, count=4)
SECOND = Request(UNIT, Function.READ_HOLDING, 78 << 8 | 2, count=2)
TIMEOUT = Request(UNIT, Function.READ_HOLDING, 14 << 8, count=1)


def xmodem(data):
    """Return the check sum of `data`, computed bit by bit like the manual's C program."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc.to_bytes(2, "big")


def test_two_signed_speeds_are_one_packet_with_its_check_sum():
    content = bytes((UNIT, 37, 0, 0, 0x03, 0xE8, 0xFF, 0xFF, 0xFC, 0x18))
    assert build(SPEEDS) == content + xmodem(content)
    assert reply_size(SPEEDS) == 1


def test_a_read_is_address_and_command_and_its_answer_is_summed_over_both():
    assert build(ENCODERS) == bytes((UNIT, 78))
    content = bytes((0, 1, 2, 3, 4, 5, 6, 7))
    reply = content + xmodem(bytes((UNIT, 78)) + content)
    assert parse(ENCODERS, reply) == (0x0001, 0x0203, 0x0405, 0x0607)
    assert parse(SECOND, reply) == (0x0405, 0x0607)


def test_the_timeout_has_one_byte_and_a_command_each_to_write_and_read_it():
    write = Request(UNIT, Function.WRITE_MULTIPLE, 14 << 8, values=(5,))
    assert build(write) == bytes((UNIT, 14, 5)) + xmodem(bytes((UNIT, 14, 5)))
    assert build(TIMEOUT) == bytes((UNIT, 15))
    assert parse(TIMEOUT, b"\x05" + xmodem(bytes((UNIT, 15, 5)))) == (5,)


def test_content_that_is_not_named_is_zero():
    only_second = Request(UNIT, Function.WRITE_MULTIPLE, 37 << 8 | 2, values=(0, 7))
    assert build(only_second)[2:10] == bytes((0, 0, 0, 0, 0, 0, 0, 7))


@pytest.mark.parametrize(
    "reply",
    [b"", b"\xff", b"\x00" * 10, build_reply(b"\x81\x4e", (0, 1, 2, 3)), b"\xff" * 11],
)
def test_a_wrong_reply_is_refused(reply):
    with pytest.raises(PacketError):
        parse(ENCODERS, reply)


def test_a_write_is_acknowledged_by_one_byte_and_nothing_else():
    assert parse(SPEEDS, ACKNOWLEDGED) == ()
    with pytest.raises(PacketError):
        parse(SPEEDS, b"\x00")


@pytest.mark.parametrize("function", [Function.READ_HOLDING, Function.WRITE_MULTIPLE])
def test_unknown_commands_are_never_sent(function):
    with pytest.raises(PacketError, match="not known"):
        build(Request(UNIT, function, 94 << 8, count=1, values=(0,)))


@given(st.sampled_from(sorted(READ_BYTES)), st.data())
def test_the_controller_s_side_and_ours_agree_on_reads(command, data):
    packet = bytes((UNIT, command))
    asked = parse_packet(packet)
    size = READ_BYTES[command]
    words = data.draw(st.tuples(*[st.integers(0, 0xFFFF if size > 1 else 0xFF)] * asked.count))
    assert build(asked) == packet
    assert parse(asked, build_reply(packet, words)) == words


@given(st.sampled_from(sorted(WRITE_BYTES)), st.data())
def test_the_controller_s_side_and_ours_agree_on_writes(command, data):
    size = WRITE_BYTES[command]
    word = st.integers(0, 0xFFFF if size > 1 else 0xFF)
    words = data.draw(st.tuples(*[word] * -(-size // 2)))
    request = Request(UNIT, Function.WRITE_MULTIPLE, command << 8, values=words)
    packet = build(request)
    assert packet_bytes(packet) == len(packet)
    assert parse_packet(packet) == request
    spoiled = bytes((*packet[:-1], packet[-1] ^ 1))
    with pytest.raises(PacketError):
        parse_packet(spoiled)


def test_every_register_of_the_profile_has_its_command():
    for register in find_profile("roboclaw").registers.values():
        words = register.type.words
        if "r" in register.access:
            build(Request(UNIT, Function.READ_HOLDING, register.address, count=words))
        if "w" in register.access:
            values = (0,) * words
            build(Request(UNIT, Function.WRITE_MULTIPLE, register.address, values=values))
