# SPDX-License-Identifier: Apache-2.0
"""RTU frames: a built frame is parsed back, and any other is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord_hal.modbus.codec import (
    CrcError,
    FrameError,
    Function,
    Reply,
    Request,
    build_exception,
    build_reply,
    build_request,
    character_bits,
    crc16,
    frame_time_s,
    parse_reply,
    parse_request,
    reply_bytes,
    request_bytes,
    seal,
    silent_interval_s,
)

WORD = st.integers(0, 0xFFFF)
UNIT = st.integers(1, 247)
ADDRESS = st.integers(0, 0xFF00)


def words(most):
    return st.lists(WORD, min_size=1, max_size=most).map(tuple)


REQUESTS = st.one_of(
    st.builds(
        Request,
        UNIT,
        st.sampled_from([Function.READ_HOLDING, Function.READ_INPUT]),
        ADDRESS,
        count=st.integers(1, 125),
    ),
    st.builds(Request, UNIT, st.just(Function.WRITE_SINGLE), ADDRESS, values=words(1)),
    st.builds(Request, UNIT, st.just(Function.WRITE_MULTIPLE), ADDRESS, values=words(123)),
    st.builds(
        Request,
        UNIT,
        st.just(Function.READ_WRITE),
        ADDRESS,
        st.integers(1, 125),
        ADDRESS,
        words(121),
    ),
)


def test_the_check_sum_is_the_standard_s():
    """According to MODBUS over Serial Line V1.02, annex B, 02 07 gives 41 12 on the wire."""
    assert seal(b"\x02\x07") == b"\x02\x07\x41\x12"
    assert crc16(b"123456789") == 0x4B37


def test_a_known_read_has_the_known_bytes():
    frame = build_request(Request(1, Function.READ_HOLDING, 0, count=10))
    assert frame == bytes.fromhex("01 03 00 00 00 0a c5 cd")


@given(REQUESTS)
def test_a_request_comes_back_whole(request_):
    frame = build_request(request_)
    assert parse_request(frame) == request_
    assert request_bytes(frame) == len(frame) <= 256


@given(REQUESTS, st.data())
def test_a_request_s_length_is_known_before_it_is_whole_or_not_at_all(request_, data):
    frame = build_request(request_)
    part = frame[: data.draw(st.integers(0, len(frame)))]
    assert request_bytes(part) in (None, len(frame))


def reply_of(request, data):
    read = tuple(data.draw(st.lists(WORD, min_size=request.count, max_size=request.count)))
    return build_reply(request, read), read


@given(REQUESTS, st.data())
def test_a_reply_comes_back_with_its_words(request_, data):
    frame, read = reply_of(request_, data)
    assert len(frame) == reply_bytes(request_) <= 256
    assert parse_reply(request_, frame) == Reply(read)


@given(REQUESTS, st.integers(1, 11))
def test_an_exception_comes_back_with_its_code(request_, code):
    frame = build_exception(request_.unit, request_.function, code)
    assert parse_reply(request_, frame) == Reply(exception=code)


@given(REQUESTS, st.data())
def test_a_flipped_bit_is_never_an_answer(request_, data):
    frame, _ = reply_of(request_, data)
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    torn = bytearray(frame)
    torn[bit // 8] ^= 1 << bit % 8
    with pytest.raises(FrameError):
        parse_reply(request_, bytes(torn))


@given(REQUESTS, REQUESTS, st.data())
def test_the_answer_to_another_request_is_refused_where_its_bytes_differ(one, other, data):
    frame, _ = reply_of(other, data)
    distinct = (
        one.unit != other.unit
        or one.function != other.function
        or reply_bytes(one) != reply_bytes(other)
        or (one.function in (6, 16) and build_reply(one) != build_reply(other))
    )
    if distinct:
        with pytest.raises(FrameError):
            parse_reply(one, frame)


@given(st.binary(max_size=300))
def test_noise_never_passes_for_a_frame_without_its_check_sum(noise):
    if len(noise) >= 4 and seal(noise[:-2]) == noise:
        noise = noise[:-1] + bytes([noise[-1] ^ 1])
    with pytest.raises(FrameError):
        parse_request(noise)
    with pytest.raises(FrameError):
        parse_reply(Request(1, Function.READ_HOLDING, 0, count=1), noise)


def test_a_bad_check_sum_is_no_malformed_frame():
    with pytest.raises(CrcError):
        parse_request(b"\x01\x03\x00\x00\x00\x01\x00\x00")
    with pytest.raises(FrameError, match="wrong length"):
        parse_request(seal(b"\x01\x03\x00\x00"))
    with pytest.raises(FrameError, match="function 99"):
        parse_request(seal(b"\x01\x63\x00\x00"))
    with pytest.raises(FrameError, match="2 registers in 3 bytes"):
        parse_request(seal(b"\x01\x10\x00\x00\x00\x02\x03\x00\x00\x00"))


@pytest.mark.parametrize(
    "wrong",
    [
        (248, Function.READ_HOLDING, 0, 1),
        (1, Function.READ_HOLDING, 0, 126),
        (1, Function.READ_HOLDING, 0, 0),
        (1, Function.READ_HOLDING, 0xFFFF, 2),
        (1, Function.WRITE_SINGLE, 0, 0, 0, (1, 2)),
        (1, Function.WRITE_SINGLE, 0, 0, 0, (0x10000,)),
        (1, Function.WRITE_MULTIPLE, 0, 0, 0, (0,) * 124),
        (1, Function.READ_WRITE, 0, 1, 0xFFFF, (0, 0)),
    ],
)
def test_a_request_that_the_standard_forbids_cannot_be_made(wrong):
    with pytest.raises(FrameError):
        Request(*wrong)


def test_a_reply_is_not_built_with_the_wrong_number_of_words():
    with pytest.raises(FrameError):
        build_reply(Request(1, Function.READ_HOLDING, 0, count=2), (1,))


def test_a_broadcast_is_not_answered():
    assert reply_bytes(Request(0, Function.WRITE_SINGLE, 0, values=(1,))) == 0


@pytest.mark.parametrize(
    ("baudrate", "bits", "want_s"),
    [
        (9600, 10, 3.5 * 10 / 9600),
        (19200, 11, 3.5 * 11 / 19200),
        (19201, 11, 1.75e-3),
        (10**6, 10, 1.75e-3),
    ],
)
def test_the_silent_interval_is_the_standard_s(baudrate, bits, want_s):
    assert silent_interval_s(baudrate, bits) == want_s


def test_wire_time_counts_every_bit():
    assert character_bits("none", 1) == 10
    assert character_bits("even", 2) == 12
    assert frame_time_s(33, 115200, "none", 1) == pytest.approx(2.8646e-3, rel=1e-4)
