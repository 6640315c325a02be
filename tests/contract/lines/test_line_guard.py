# SPDX-License-Identifier: Apache-2.0
"""The guard refuses what pymodbus accepts: a peer on a pty misbehaves in real bytes."""

import asyncio
import time

import pytest
from loop_side import until
from scripted_slave import ScriptedSlave, Unit

from motord_hal.base.errors import BadReply, NoReply, PortError, Refused
from motord_hal.modbus.codec import (
    SILENT_FIXED_S,
    Function,
    Request,
    build_exception,
    build_reply,
    seal,
)
from motord_hal.modbus.guard import BROADCAST_TURNAROUND_S, GuardedClient

READ = Request(1, Function.READ_HOLDING, 0x10, count=1)
SHORT_S = 0.03
LONG_S = 5.0


def read(address, count=1, unit=1):
    return Request(unit, Function.READ_HOLDING, address, count=count)


def write(address, *values, unit=1):
    function = Function.WRITE_SINGLE if len(values) == 1 else Function.WRITE_MULTIPLE
    return Request(unit, function, address, values=values)


def instead(data):
    """Return a trick that sends these bytes instead of the reply."""
    return lambda request, honest: [(0.0, data)]


@pytest.fixture
async def peer(tmp_path):
    peer = ScriptedSlave(tmp_path / "port")
    peer.units = {1: Unit(dict.fromkeys(range(0x10, 0x40), 0)), 2: Unit({0x10: 0x2B})}
    peer.units[1].registers.update({0x10: 0x1111, 0x11: 0x2222})
    yield peer
    peer.pull()


@pytest.fixture
async def client(peer):
    client = GuardedClient(str(peer.path), 115200, "none", 1, None)
    await client.open()
    yield client
    client.close()


async def test_an_honest_reply_is_read_with_its_time(client):
    before_ns = time.monotonic_ns()
    answer = await client.exchange(read(0x10, 2), LONG_S)
    assert answer.values == (0x1111, 0x2222)
    assert before_ns < answer.stamp_ns < time.monotonic_ns()
    assert answer.round_trip_s > 0


async def test_a_late_reply_is_not_given_to_the_next_request(client, peer):
    peer.tricks.append(lambda request, honest: [(SHORT_S * 1.6, honest)])
    with pytest.raises(NoReply):
        await client.exchange(read(0x10), SHORT_S)
    assert (await client.exchange(read(0x11), LONG_S)).values == (0x2222,)


async def test_the_late_reply_to_a_cancelled_request_is_not_given_to_the_next(client, peer):
    peer.tricks.append(lambda request, honest: [(0.05, honest)])
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.02):
            await client.exchange(read(0x10), 0.1)
    assert (await client.exchange(read(0x11), LONG_S)).values == (0x2222,)


async def test_a_cancellation_passes_through(client, peer):
    peer.units[1].silent = True
    task = asyncio.ensure_future(client.exchange(READ, LONG_S))
    await until(lambda: peer.received)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert task.cancelled()


@pytest.mark.parametrize(
    ("request_", "sent"),
    [
        pytest.param(
            read(0x10, 10), build_reply(read(0x10, 2), (1, 2)), id="fewer registers than requested"
        ),
        pytest.param(
            read(0x10, 2), build_reply(read(0x10, 3), (1, 2, 3)), id="more registers than requested"
        ),
        pytest.param(
            READ, build_reply(Request(1, Function.READ_INPUT, 0x10, count=1), (7,)), id="function"
        ),
        pytest.param(READ, build_reply(read(0x10, 1, unit=2), (7,)), id="another unit"),
        pytest.param(READ, build_exception(1, 6, 2), id="an exception to another function"),
        pytest.param(write(0x10, 5), build_reply(write(0x11, 5)), id="echo of another address"),
        pytest.param(write(0x10, 5), build_reply(write(0x10, 6)), id="echo of another value"),
        pytest.param(write(0x20, 5, 6), build_reply(write(0x20, 5, 6, 7)), id="echo of a count"),
        pytest.param(READ, b"\x01\x03\x02\x00\x07\xff\xff", id="bad CRC"),
        pytest.param(READ, build_reply(READ, (7,))[:-1], id="torn"),
        pytest.param(READ, seal(b"\x01\x03\x04\x00\x07"), id="wrong byte count"),
    ],
)
async def test_an_answer_to_another_request_is_refused(client, peer, request_, sent):
    peer.tricks.append(instead(sent))
    with pytest.raises(BadReply):
        await client.exchange(request_, SHORT_S)
    assert (await client.exchange(read(0x11), LONG_S)).values == (0x2222,)


@pytest.mark.parametrize(
    "garbage", [b"\x00", b"\x01\x03", b"\xff\xff\x00", b"\x01\x83\x02", bytes(200)], ids=repr
)
async def test_a_good_reply_is_found_after_garbage(client, peer, garbage):
    peer.tricks.append(lambda request, honest: [(0.0, garbage + honest)])
    assert (await client.exchange(READ, LONG_S)).values == (0x1111,)


async def test_a_reply_may_come_byte_by_byte(client, peer):
    def drip(request, honest):
        return [(0.002 * n, bytes([byte])) for n, byte in enumerate(honest, 1)]

    peer.tricks.append(drip)
    assert (await client.exchange(read(0x10, 2), LONG_S)).values == (0x1111, 0x2222)


async def test_bytes_that_were_not_requested_are_thrown_away(client, peer):
    peer.send(build_reply(READ, (0xDEAD,)))
    assert (await client.exchange(READ, LONG_S)).values == (0x1111,)


async def test_an_exception_reports_its_code_and_meaning(client, peer):
    peer.tricks.append(instead(build_exception(1, Function.READ_HOLDING, 4)))
    with pytest.raises(Refused, match="server device failure") as error:
        await client.exchange(READ, LONG_S)
    assert error.value.code == 4


async def test_the_line_is_silent_before_each_request(client, peer):
    for _ in range(5):
        await client.exchange(READ, LONG_S)
    pairs = zip(peer.answered_at_s, peer.received[1:], strict=False)
    assert all(received.at_s - answered >= SILENT_FIXED_S for answered, received in pairs)


async def test_a_broadcast_is_followed_by_the_turnaround_delay(client, peer):
    assert (await client.exchange(write(0x10, 5, unit=0), LONG_S)).values == ()
    await client.exchange(READ, LONG_S)
    first, second = peer.received
    assert (first.request.unit, second.request.unit) == (0, 1)
    assert second.at_s - first.at_s >= BROADCAST_TURNAROUND_S / 2


async def test_a_reply_in_the_buffer_counts_even_when_the_loop_was_late(client, peer):
    def stall(request, honest):
        peer.send(honest)
        time.sleep(0.1)  # blocks the event loop past the deadline
        return []

    peer.tricks.append(stall)
    assert (await client.exchange(READ, SHORT_S)).values == (0x1111,)


async def test_a_line_that_is_never_silent_is_reported(peer):
    client = GuardedClient(str(peer.path), 115200, "none", 1, gap_s=0.15)
    await client.open()
    async with asyncio.TaskGroup() as group:

        async def babble():
            while True:
                peer.send(b"\x55")
                await asyncio.sleep(0.001)

        babbler = group.create_task(babble())
        with pytest.raises(BadReply, match="never silent"):
            await client.exchange(READ, LONG_S)
        babbler.cancel()
    client.close()


async def test_only_one_request_is_in_flight(client, peer):
    answers = await asyncio.gather(*(client.exchange(read(0x10 + n % 2), LONG_S) for n in range(6)))
    assert [answer.values for answer in answers] == [(0x1111,), (0x2222,)] * 3


async def test_the_line_pauses_for_a_unit_that_did_not_answer_and_not_for_its_neighbours(
    client, peer
):
    peer.units[1].silent = True
    with pytest.raises(NoReply):
        await client.exchange(READ, 0.4)
    assert (await client.exchange(read(0x10, unit=2), LONG_S)).values == (0x2B,)
    with pytest.raises(NoReply):
        await client.exchange(READ, SHORT_S)
    first, neighbour, again = peer.received
    assert neighbour.at_s - first.at_s < 0.8 <= again.at_s - first.at_s


async def test_a_pulled_port_is_a_port_error(client, peer):
    await client.exchange(READ, LONG_S)
    peer.pull()
    with pytest.raises(PortError):
        await client.exchange(READ, SHORT_S)
    assert not client.connected


async def test_a_port_pulled_in_mid_exchange_is_a_port_error(client, peer):
    def pull(request, honest):
        peer.pull()
        return []

    peer.tricks.append(pull)
    with pytest.raises(PortError):
        await client.exchange(READ, SHORT_S)


async def test_a_port_can_be_opened_only_once(client, peer):
    second = GuardedClient(str(peer.path), 115200, "none", 1, None)
    with pytest.raises(PortError, match="another program"):
        await second.open()


async def test_an_absent_port_is_named_with_the_reason(tmp_path):
    client = GuardedClient(str(tmp_path / "nothing"), 115200, "none", 1, None)
    with pytest.raises(PortError, match="no such port"):
        await client.open()
    with pytest.raises(PortError):
        await client.exchange(READ, SHORT_S)


async def test_a_plain_file_is_refused_as_a_port(tmp_path):
    path = tmp_path / "file"
    path.write_text("")
    with pytest.raises(PortError):
        await GuardedClient(str(path), 115200, "none", 1, None).open()


async def test_failing_tries_write_no_log(client, peer, caplog):
    caplog.set_level("DEBUG")
    peer.units[1].silent = True
    for _ in range(3):
        with pytest.raises(NoReply):
            await client.exchange(READ, 0.005)
    assert [r for r in caplog.records if r.name.startswith("pymodbus") and r.levelno > 10] == []


async def test_a_reply_received_in_pieces_is_traced_once(client, peer):
    honest = build_reply(READ, (0x1111,))
    client.trace.switch(on=True)
    peer.tricks.append(instead(honest[:3]))
    async with asyncio.TaskGroup() as group:
        group.create_task(client.exchange(READ, LONG_S))
        await until(lambda: client.trace.newest >= 2, "the first piece")
        peer.send(honest[3:])
    received = [entry.data for entry in client.trace.after(0) if not entry.outward]
    assert received == [honest[:3], honest[3:]]


async def test_bytes_that_arrive_late_are_traced(client, peer):
    client.trace.switch(on=True)
    peer.tricks.append(lambda request, honest: [(SHORT_S * 1.6, honest)])
    with pytest.raises(NoReply):
        await client.exchange(READ, SHORT_S)
    await client.exchange(read(0x11), LONG_S)
    received = b"".join(entry.data for entry in client.trace.after(0) if not entry.outward)
    assert received == build_reply(READ, (0x1111,)) + build_reply(READ, (0x2222,))
