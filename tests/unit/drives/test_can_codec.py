# SPDX-License-Identifier: Apache-2.0
"""CAN frames: the places of signals, compared with cantools, and the number of bits on the wire."""

import math
import struct

import cantools.database
import pytest
from cantools.database.can.signal import Signal as DbcSignal
from cantools.database.conversion import BaseConversion
from hypothesis import given
from hypothesis import strategies as st

from motord.config.drives.load import find_profile
from motord_hal.can.codec import build, frame_bits, frame_time_s, parse
from motord_hal.can.errors import WARN_EVERY_S, BusTrouble, BusWarnings, error_words
from motord_hal.can.netlink import answer_error, restart_request
from motord_hal.drives.can_profile import Frame, Sender, Signal
from motord_hal.drives.profile import RegisterType

FRAME = Frame(
    name="f", base=0x100, node_shift=5, extended=False, fd=False, size_bytes=8,
    sender=Sender.MOTORD, begins=b"", ask="", period_s=0.0, silence_s=0.0, source="here",
)  # fmt: skip


def signal(start_bit=0, length=32, kind="i32", unit="", big=False, **more):
    values = {
        "name": "s", "address": 0x100, "type": RegisterType(kind), "scale": 1.0, "unit": unit,
        "access": "w", "minimum": None, "maximum": None, "source": "here", "frame": "f",
        "start_bit": start_bit, "length": length, "big_endian": big,
    }  # fmt: skip
    return Signal(**{**values, **more})


@st.composite
def places(draw):
    length = draw(st.integers(1, 32))
    signed = draw(st.booleans()) and length > 1
    place = signal(
        start_bit=draw(st.integers(0, 64 - length)), length=length,
        kind="i32" if signed else "u32", big=draw(st.booleans()),
    )  # fmt: skip
    return place, draw(st.integers(*place.raw_range))


def as_dbc(place):
    """Return the place as a DBC file gives it: it counts a big-endian start bit in a zigzag."""
    start = place.start_bit
    if place.big_endian:
        start = 8 * (start // 8) + 7 - start % 8
    order = "big_endian" if place.big_endian else "little_endian"
    conversion = BaseConversion.factory(scale=1, offset=0)
    sign = place.type.signed
    return DbcSignal("s", start, place.length, order, is_signed=sign, conversion=conversion)


@given(places())
def test_a_signal_stands_where_cantools_finds_it(place_and_raw):
    place, raw = place_and_raw
    data = build(FRAME, (place,), {"s": raw})
    message = cantools.database.Message(0x100, "f", 8, [as_dbc(place)])
    assert message.decode(data)["s"] == raw
    assert parse(FRAME, (place,), data) == {"s": raw}


@given(places(), st.binary(min_size=8, max_size=8))
def test_a_signal_changes_no_bit_beside_it(place_and_raw, before):
    place, raw = place_and_raw
    after = bytearray(before)
    place.insert(after, raw)
    rest = signal(place.start_bit, place.length, "u32", big=place.big_endian)
    for data in (after, beside := bytearray(before)):
        rest.insert(data, 0)
    assert after == beside


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_float_comes_back_as_it_was_and_as_struct_packs_it(value):
    place = signal(kind="f32")
    raw = place.from_si(value)
    assert place.to_si(raw) == value
    assert build(FRAME, (place,), {"s": raw})[:4] == struct.pack("<f", value + 0.0)


def test_a_float_that_is_not_finite_is_not_sent_and_is_read_as_it_is():
    place = signal(kind="f32")
    for bad in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError):
            place.from_si(bad)
        raw = int.from_bytes(struct.pack("<f", bad), "little")
        assert not math.isfinite(place.to_si(raw))


def test_negative_zero_is_written_as_zero():
    assert signal(kind="f32").from_si(-0.0) == 0
    assert signal(kind="f32", unit="turn/s").from_si(-0.0) == 0


@given(st.floats(-1e6, 1e6), st.sampled_from(["i16", "i32", "f32"]))
def test_a_value_stays_within_its_own_limits(value, kind):
    place = signal(kind=kind, length=32 if kind != "i16" else 16, minimum=-3.0, maximum=2.0)
    assert -3.0 <= place.to_si(place.from_si(value)) <= 2.0


def test_a_value_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        build(FRAME, (signal(length=4, kind="u32"),), {"s": 16})


def test_the_first_bytes_of_a_frame_distinguish_it():
    sent = Frame(**{**{f: getattr(FRAME, f) for f in FRAME.__slots__}, "begins": b"\x9c"})
    place = signal(start_bit=8, length=8, kind="u8")
    assert build(sent, (place,), {"s": 7}) == bytes((0x9C, 7, 0, 0, 0, 0, 0, 0))
    assert parse(sent, (place,), bytes((0x9A, 7, 0, 0, 0, 0, 0, 0))) is None
    assert parse(sent, (place,), bytes((0x9C, 7))) is None
    assert sent.identifier(3) == 0x160


@pytest.mark.parametrize(
    ("size_bytes", "extended", "bits"), [(0, False, 55), (8, False, 135), (8, True, 160)]
)
def test_a_frame_has_as_many_bits_as_with_the_most_stuffing(size_bytes, extended, bits):
    assert frame_bits(size_bytes, extended=extended) == bits


def test_an_fd_frame_is_faster_where_its_data_are():
    fd = Frame(**{**{f: getattr(FRAME, f) for f in FRAME.__slots__}, "fd": True, "size_bytes": 64})
    slow_s, fast_s = frame_time_s(fd, 1_000_000, None), frame_time_s(fd, 1_000_000, 5_000_000)
    assert 600e-6 < slow_s < 750e-6
    assert 130e-6 < fast_s < 200e-6


@pytest.mark.parametrize(
    ("reply", "understood"),
    [
        ("4B 5A 60 00 02 00 00 00", True),
        ("42 5A 60 00 02 00 00 00", True),  # without the size of the object
        ("43 5A 60 00 02 00 00 00", False),  # the object has four bytes: another kind
        ("4B 5A 60 01 02 00 00 00", False),
    ],
)
def test_a_reply_to_an_sdo_upload_may_omit_its_size_but_not_give_another(reply, understood):
    profile = find_profile("cia402")
    frame = profile.can.frames["sdo_read_quick_stop_option"]
    assert frame.matches(bytes.fromhex(reply)) is understood


def test_error_frames_are_read_as_the_kernel_writes_them():
    assert error_words(0x40, bytes(8)) == (["bus_off"], BusTrouble.BUS_OFF)
    assert error_words(0x04, bytes((0, 0x01))) == (["overflow"], BusTrouble.NONE)
    assert error_words(0x04, bytes((0, 0x04))) == (["error_frame"], BusTrouble.NONE)
    assert error_words(0x28, b"") == (["protocol", "no_ack"], BusTrouble.NONE)


def test_a_restart_request_has_the_form_that_the_kernel_reads():
    message = restart_request(7, 1)
    assert struct.unpack_from("=IHHII", message) == (len(message), 16, 5, 1, 0)
    assert struct.unpack_from("=i", message, 20) == (7,)
    assert message.endswith(struct.pack("=HHI", 8, 7, 1))
    assert b"can\x00" in message
    refused = struct.pack("=IHHIIi", 36, 2, 0, 1, 0, -1)
    assert answer_error(refused) == 1
    with pytest.raises(ValueError):
        answer_error(refused[:12])


def test_a_warning_is_reported_again_when_it_goes_on_for_long():
    warnings = BusWarnings()
    assert len(warnings.new(["no_ack", "error_passive", "protocol"], 100.0)) == 2
    assert warnings.new(["no_ack"], 100.0 + WARN_EVERY_S / 2) == []
    assert len(warnings.new(["no_ack", "no_ack"], 100.0 + WARN_EVERY_S)) == 1
    assert warnings.new(["bus_off"], 500.0) == []  # the loss of the line has its own report
