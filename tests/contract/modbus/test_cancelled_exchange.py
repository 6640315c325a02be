# SPDX-License-Identifier: Apache-2.0
"""A line or an exchange ends when it is cancelled, at any moment."""

import asyncio

import pytest
from loop_side import GENEROUS_S, LoopSide, until
from modbus_rig import hub_servo
from modbus_rig import spec_of as line_spec_of
from scripted_gateway import peer_on
from sim_bench import simulated, spec_of

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.open_line import open_line
from motord_hal.modbus.codec import Function, Request
from motord_hal.modbus.guard import GuardedClient
from motord_hal.modbus.tcp_guard import GatewayClient
from motord_hal.realtime.exchange import Exchange

READ = Request(1, Function.READ_HOLDING, 0x0100, 1)


@pytest.fixture
def profile():
    return find_profile("duty-register")


async def test_a_cancellation_that_meets_the_reply_is_not_lost(profile, tmp_path):
    with simulated(profile, tmp_path):
        client = GuardedClient(str(tmp_path / "bus"), 115200, "none", 1, None)
        await client.open()
        exchange = asyncio.ensure_future(client.exchange(READ, GENEROUS_S))
        while client._framer.reply is None:
            await asyncio.sleep(0)
        exchange.cancel()
        await asyncio.wait([exchange], timeout=GENEROUS_S)
        assert exchange.cancelled()
        client.close()


@pytest.mark.parametrize("later_s", [n * 0.0007 for n in range(10)])
async def test_a_cancelled_line_ends(profile, tmp_path, later_s):
    with simulated(profile, tmp_path):
        loop = LoopSide(Exchange.private())
        loop.put()
        line = open_line(spec_of(profile, tmp_path), loop.exchange, lambda event: None)
        task = asyncio.ensure_future(line.run())
        await until(lambda: line.stats().exchanges > 5, "it talks")
        await asyncio.sleep(later_s)
        task.cancel()
        await asyncio.wait([task], timeout=GENEROUS_S)
        assert task.cancelled()


@pytest.mark.parametrize("medium", ["asyncio", "modbus-tcp"])
async def test_a_cancellation_that_meets_the_opening_is_not_lost_and_closes_it(medium, tmp_path):
    peer = peer_on(medium, tmp_path)

    def new_client():
        if medium == "modbus-tcp":
            return GatewayClient(line_spec_of(peer, hub_servo()))
        return GuardedClient(str(peer.path), 115200, "none", 1, None)

    for turns in range(8):  # turns of the event loop before the cancellation
        client = new_client()
        opening = asyncio.ensure_future(client.open())
        for _ in range(turns):
            await asyncio.sleep(0)
        obeyed = opening.cancel()
        await asyncio.wait([opening], timeout=GENEROUS_S)
        assert opening.cancelled() is obeyed
        assert client.connected is not obeyed
        client.close()
    again = new_client()
    await again.open()  # no earlier client holds the port
    again.close()
    peer.pull()
