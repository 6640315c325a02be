# SPDX-License-Identifier: Apache-2.0
"""Recognition of bytes that are the answer to a request that has timed out."""

import pytest

from motord_hal.modbus.codec import Function, Request, build_exception, build_reply, build_request
from motord_hal.modbus.late import KEPT_BYTES, LateReplies

POSITION = Request(1, Function.READ_HOLDING, 0x20A7, count=2)
VOLTAGE = Request(1, Function.READ_HOLDING, 0x2000, count=2)
NEIGHBOUR = Request(2, Function.READ_HOLDING, 0x20A7, count=2)
SETPOINT = Request(1, Function.WRITE_MULTIPLE, 0x2088, values=(0, 0))
ONE_WRITE = Request(1, Function.WRITE_SINGLE, 0x200E, values=(7,))
REPLY = build_reply(POSITION, (1, 2))


@pytest.fixture
def late():
    late = LateReplies()
    late.sent()
    return late


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        (POSITION, REPLY),
        (SETPOINT, build_reply(SETPOINT)),
        (POSITION, build_exception(1, Function.READ_HOLDING, 2)),
    ],
)
def test_an_answer_that_comes_after_its_time_is_late(late, request_, reply):
    late.failed(request_)
    late.came(b"\x00" + reply[:4])
    late.look()
    assert late.count == 0
    late.came(reply[4:])
    late.look()
    late.look()
    assert late.count == 1


def test_half_of_a_late_answer_may_have_come_in_time(late):
    late.came(REPLY[:5])
    late.failed(POSITION)
    late.came(REPLY[5:])
    late.look()
    assert late.count == 1


def test_a_late_answer_may_come_with_that_of_a_neighbour(late):
    late.failed(POSITION)
    late.sent()
    late.came(REPLY + build_reply(NEIGHBOUR, (3, 4)))
    late.answered(NEIGHBOUR)
    assert late.count == 1


def test_a_late_answer_may_come_while_the_unit_owes_the_next_one(late):
    late.failed(POSITION)
    late.sent()
    late.came(REPLY)
    late.failed(SETPOINT)
    assert late.count == 1


@pytest.mark.parametrize("next_", [POSITION, VOLTAGE])
def test_an_answer_that_is_lost_does_not_make_the_next_one_late(late, next_):
    late.failed(POSITION)
    late.sent()
    late.came(build_reply(next_, (3, 4)))
    late.answered(next_)
    late.look()
    assert late.count == 0


@pytest.mark.parametrize(
    "noise",
    [
        b"",
        REPLY[:-1],
        REPLY[:-1] + bytes([REPLY[-1] ^ 1]),
        build_reply(NEIGHBOUR, (1, 2)),
        build_request(POSITION),
        bytes(KEPT_BYTES),
        b"\x01" * KEPT_BYTES,
    ],
)
def test_noise_is_not_late(late, noise):
    late.failed(POSITION)
    late.came(noise)
    late.look()
    assert late.count == 0


def test_what_came_before_the_request_does_not_answer_it(late):
    late.came(REPLY)
    late.sent()
    late.failed(POSITION)
    late.look()
    assert late.count == 0


def test_the_echo_of_a_single_write_is_not_its_answer(late):
    late.came(build_request(ONE_WRITE))
    late.failed(ONE_WRITE)
    late.look()
    assert late.count == 0


def test_after_a_change_of_port_no_answer_is_late(late):
    late.failed(POSITION)
    late.forget()
    late.came(REPLY)
    late.look()
    assert late.count == 0


def test_a_reply_behind_much_noise_is_found(late):
    late.failed(POSITION)
    late.came(bytes(3 * KEPT_BYTES))
    late.came(REPLY)
    late.look()
    assert late.count == 1
