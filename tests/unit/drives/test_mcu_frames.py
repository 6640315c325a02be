# SPDX-License-Identifier: Apache-2.0
"""Frames of boards: stuffing, check sums, division of a stream into frames, places of registers."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.drives.profile import Register, RegisterType
from motord_hal.mcu import cobs
from motord_hal.mcu.frames import (
    FRAME_BYTES_MAX,
    BoardImu,
    Frame,
    FrameError,
    Received,
    Splitter,
    Type,
    build,
    crc16,
    feedback_payload,
    imu_payload,
    parse,
    pick,
    place,
    setpoints_payload,
)

PAYLOADS = st.binary(max_size=FRAME_BYTES_MAX - 10)


def register(name, address, kind="i32", access="w"):
    return Register(
        name=name, address=address, type=RegisterType(kind), scale=1.0, unit="", access=access,
        minimum=None, maximum=None, source="test",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("plain", "stuffed"),
    [
        ("00", "01 01"),
        ("00 00", "01 01 01"),
        ("11 22 00 33", "03 11 22 02 33"),
        ("11 22 33 44", "05 11 22 33 44"),
        ("11 00 00 00", "02 11 01 01 01"),
    ],
)
def test_stuffing_is_that_of_the_paper(plain, stuffed):
    assert cobs.encode(bytes.fromhex(plain)) == bytes.fromhex(stuffed)


@given(st.binary(max_size=1200) | st.integers(0, 600).map(lambda size: b"\1" * size))
def test_stuffed_bytes_have_no_zero_and_come_back_as_they_were(data):
    stuffed = cobs.encode(data)
    assert 0 not in stuffed
    assert cobs.decode(stuffed) == data
    assert len(stuffed) <= len(data) + 1 + len(data) // 254


@given(st.binary(max_size=300))
def test_any_bytes_are_unstuffed_or_a_value_error(data):
    try:
        plain = cobs.decode(data)
    except ValueError:
        return
    assert cobs.decode(cobs.encode(plain)) == plain


def test_check_sums_are_those_of_the_catalogue():
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"123456789", start=0) == 0x31C3


@given(st.sampled_from(Type), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF), PAYLOADS)
def test_a_frame_comes_back_as_it_was(kind, sequence, time_us, payload):
    frame = Frame(kind, sequence, time_us, payload)
    raw = build(frame)
    assert raw[0] == raw[-1] == 0
    assert parse(raw[1:-1]) == frame


@given(PAYLOADS, st.integers(0, 10_000), st.integers(1, 255))
def test_a_corrupt_byte_makes_no_frame(payload, place, change):
    raw = bytearray(build(Frame(Type.FEEDBACK, 7, 9, payload))[1:-1])
    raw[place % len(raw)] ^= change
    with pytest.raises(FrameError):
        for piece in Splitter().feed(bytes(raw) + b"\0"):
            parse(piece)
        raise FrameError("cut into nothing")


def test_another_version_is_refused_with_the_reason():
    raw = bytearray(cobs.decode(build(Frame(Type.FEEDBACK, 0, 0, b""))[1:-1]))
    raw[0] = 2
    raw[-2:] = crc16(bytes(raw[:-2])).to_bytes(2, "little")
    with pytest.raises(FrameError, match="version 2"):
        parse(cobs.encode(bytes(raw)))


@given(st.lists(PAYLOADS, max_size=6), st.integers(1, 40))
def test_frames_are_found_in_any_pieces_of_the_stream(payloads, size):
    frames = [Frame(Type.FEEDBACK, n, n, payload) for n, payload in enumerate(payloads)]
    stream = b"".join(build(frame) for frame in frames)
    splitter = Splitter()
    found = [
        parse(piece)
        for at in range(0, len(stream), size)
        for piece in splitter.feed(stream[at : at + size])
    ]
    assert found == frames


def test_noise_before_a_frame_costs_the_noise_only():
    frame = Frame(Type.FEEDBACK, 1, 2, b"abc")
    pieces = list(Splitter().feed(b"\xff\x13noise" + build(frame)))
    assert parse(pieces[-1]) == frame


def test_bytes_without_end_are_not_kept():
    splitter = Splitter()
    for _ in range(100):
        assert list(splitter.feed(b"\xaa" * 1000)) == []
    (piece,) = splitter.feed(b"\0")
    assert len(piece) <= FRAME_BYTES_MAX + 2
    with pytest.raises(FrameError):
        parse(piece)


@given(st.sampled_from(list(RegisterType)), st.data())
def test_values_come_back_from_their_places(kind, data):
    if kind.value.endswith("low-first"):
        return
    one = register("one", 3, kind.value)
    low, high = one.raw_range
    raw = data.draw(st.integers(low, high))
    payload = bytearray(12)
    place(payload, one, raw)
    assert pick(bytes(payload), one) == raw
    with pytest.raises(ValueError, match="does not fit"):
        place(payload, one, high + 1)


def test_a_short_payload_is_an_error_that_names_the_register():
    with pytest.raises(FrameError, match="one"):
        pick(bytes(5), register("one", 3))


def test_a_set_point_without_a_value_is_sent_as_zero():
    registers = [register("left", 6), register("right", 12), register("seen", 0, access="r")]
    payload = setpoints_payload(registers, {"right": -2}, motors=2, feedback_s=0.02)
    assert payload == bytes((0, 2, 0, 0, 20, 0, *bytes(6), 0xFE, 0xFF, 0xFF, 0xFF, 0, 0))


def test_a_board_reports_which_set_points_it_has_received_and_when():
    payload = feedback_payload([], {}, 1, 20, Received(0x1234, 0.0052))
    assert payload[6:10] == bytes((0x34, 0x12, 52, 0))


RATE = st.floats(-2147.0, 2147.0)
ACCELERATION = st.floats(-32.0, 32.0)


def imu_in(payload):
    """Return rates, accelerations and flags as a line reads them from a payload."""
    *counts, flags = struct.unpack("<3i3hH", payload)
    return [1e-6 * count for count in counts[:3]], [1e-3 * count for count in counts[3:]], flags


@given(st.tuples(RATE, RATE, RATE), st.tuples(*[ACCELERATION] * 3), st.booleans())
def test_an_inertial_sensor_is_behind_the_motors_in_its_units(rates, accelerations, saturated):
    found = imu_in(imu_payload(BoardImu(rates, accelerations, saturated)))
    assert found[0] == pytest.approx(rates, abs=0.6e-6)
    assert found[1] == pytest.approx(accelerations, abs=0.6e-3)
    assert found[2] == saturated


def test_an_axis_that_is_not_measured_has_its_own_code_and_others_saturate():
    beyond = BoardImu((math.nan, math.inf, 1e9), (-math.inf, -1e9, 0.0), saturated=False)
    found = imu_in(imu_payload(beyond))
    assert found[0] == pytest.approx([-2147.483648, -2147.483648, 2147.483647])
    assert found[1] == pytest.approx([-32.768, -32.767, 0.0])
