# SPDX-License-Identifier: Apache-2.0
"""Ten-byte frames of DDSM motors: check sums, places, and requests that are not answered."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.ddsm.codec import (
    Command,
    build_reply,
    build_request,
    crc8,
    is_answered,
    pick,
    seal,
    sealed,
)
from motord_hal.drives.profile import Register, RegisterType


def register(address, kind=RegisterType.I16, mask=None):
    return Register(
        name=f"r{address:04x}", address=address, type=kind, scale=1.0, unit="", access="rw",
        minimum=None, maximum=None, source="", mask=mask,
    )  # fmt: skip


SPEED = register(0x6402)


def test_the_check_sum_is_that_of_the_catalogue():
    assert crc8(b"123456789") == 0xA1  # check of CRC-8/MAXIM-DOW in the CRC RevEng catalogue


@pytest.mark.parametrize(
    ("rpm", "frame"),
    [
        (50, "01 64 00 32 00 00 00 00 00 d3"),
        (100, "01 64 00 64 00 00 00 00 00 4f"),
        (-50, "01 64 ff ce 00 00 00 00 00 da"),
    ],
)
def test_a_speed_is_the_frame_of_the_maker_s_table(rpm, frame):
    assert build_request(1, Command.SET, {SPEED: rpm}).hex(" ") == frame


def test_a_mode_is_sent_without_a_check_sum_and_not_answered():
    mode = register(0xA008, RegisterType.U16)  # placed in the last two bytes
    assert build_request(1, Command.MODE, {mode: 2}) == bytes((1, 0xA0, 0, 0, 0, 0, 0, 0, 0, 2))
    assert not is_answered(Command.MODE)
    assert is_answered(Command.SET)
    assert is_answered(Command.QUERY)


@pytest.mark.parametrize("raw", [-0x8001, 0x8000])
def test_a_number_that_does_not_fit_is_refused(raw):
    with pytest.raises(ValueError, match="does not fit"):
        build_request(1, Command.SET, {SPEED: raw})


@given(st.integers(-0x8000, 0x7FFF), st.integers(1, 0xFE))
def test_a_number_comes_back_from_its_place(raw, unit):
    reply = build_reply(unit, 2, {register(0x6404): raw})
    assert sealed(reply)
    assert reply[:2] == bytes((unit, 2))
    assert pick(reply, register(0x6404)) == raw


def test_a_mask_takes_bits_out_of_a_number():
    reply = build_reply(1, 2, {register(0x6406, RegisterType.U16): 0x1234})
    assert pick(reply, register(0x6406, RegisterType.U16, mask=0x0FF0)) == 0x23


@given(st.binary(min_size=9, max_size=9), st.integers(0, 79))
def test_no_flipped_bit_passes(body, bit):
    frame = bytearray(seal(body + b"\0"))
    assert sealed(bytes(frame))
    frame[bit // 8] ^= 1 << bit % 8
    assert not sealed(bytes(frame))
    assert not sealed(bytes(frame[:-1]))
