# SPDX-License-Identifier: Apache-2.0
"""Which replies a gateway's client accepts: one exchange at a time against a scripted gateway."""

import struct

import pytest
from modbus_rig import hub_servo, registers_of, spec_of
from scripted_gateway import GATEWAYS, peer_on
from scripted_slave import Unit

from motord_hal.base.errors import BadReply, NoReply, PortError
from motord_hal.modbus import tcp_guard
from motord_hal.modbus.codec import Function, Request, build_exception, build_reply
from motord_hal.modbus.tcp_guard import GatewayClient

WITHIN_S = 0.15
VOLTAGE = Request(1, Function.READ_HOLDING, 0x20A1, count=1)


async def opened(peer):
    peer.units = {1: Unit(registers_of("zlac8015d"))}
    client = GatewayClient(spec_of(peer, hub_servo()))
    await client.open()
    return client


@pytest.fixture
async def peer():
    peer = peer_on("modbus-tcp", None)
    yield peer
    peer.pull()


@pytest.fixture
async def client(peer):
    client = await opened(peer)
    yield client
    client.close()


def adu(transaction, *words, unit=1, protocol=0):
    body = struct.pack(f">BBB{len(words)}H", unit, 3, 2 * len(words), *words)
    return struct.pack(">HHH", transaction, protocol, len(body)) + body


async def test_an_honest_reply_is_accepted(client):
    assert (await client.exchange(VOLTAGE, WITHIN_S)).values == (3600,)


@pytest.mark.parametrize("cut", [0, 3, 9])
async def test_a_late_reply_is_not_given_to_the_next_request(client, peer, cut):
    """The late reply may come in two pieces, one before and one after the next request."""
    peer.tricks.append(lambda request, honest: peer.send_raw(adu(peer.transaction, 1)[:cut]) or [])
    with pytest.raises(NoReply):
        await client.exchange(VOLTAGE, WITHIN_S)
    late = adu(peer.transaction, 1)[cut:]
    peer.tricks.append(lambda request, honest: peer.send_raw(late) or [(0.0, honest)])
    assert (await client.exchange(VOLTAGE, WITHIN_S)).values == (3600,)


@pytest.mark.parametrize(
    "wrong",
    [
        build_reply(Request(2, Function.READ_HOLDING, 0, count=1), (7,)),
        build_reply(Request(1, Function.READ_HOLDING, 0, count=2), (7, 8)),
        build_reply(Request(1, Function.WRITE_SINGLE, 0x20A1, values=(7,))),
    ],
)
async def test_a_reply_with_a_wrong_unit_length_or_function_is_refused(client, peer, wrong):
    peer.tricks.append(lambda request, honest: [(0.0, wrong)])
    with pytest.raises(BadReply):
        await client.exchange(VOLTAGE, WITHIN_S)
    assert (await client.exchange(VOLTAGE, WITHIN_S)).values == (3600,)


async def test_data_that_is_not_modbus_tcp_ends_the_connection(client, peer):
    peer.tricks.append(lambda request, honest: peer.send_raw(adu(1, 7, protocol=5)) or [])
    with pytest.raises(BadReply, match="no Modbus TCP"):
        await client.exchange(VOLTAGE, WITHIN_S)
    with pytest.raises(PortError):
        await client.exchange(VOLTAGE, WITHIN_S)
    await client.open()
    assert (await client.exchange(VOLTAGE, WITHIN_S)).values == (3600,)


async def test_a_drive_that_the_gateway_cannot_reach_counts_as_silent(client, peer):
    refusal = build_exception(1, Function.READ_HOLDING, 11)
    peer.tricks.append(lambda request, honest: [(0.0, refusal)])
    with pytest.raises(NoReply, match="gateway target did not respond"):
        await client.exchange(VOLTAGE, WITHIN_S)


async def test_a_gateway_that_has_dropped_the_connection_is_connected_again(
    client, peer, monkeypatch
):
    monkeypatch.setattr(tcp_guard, "SILENT_S", 0.0)
    peer.units[1].silent = True
    with pytest.raises(NoReply):
        await client.exchange(VOLTAGE, WITHIN_S)
    assert peer.connections == 1
    peer.units[1].silent = False
    assert (await client.exchange(VOLTAGE, WITHIN_S)).values == (3600,)
    assert peer.connections == 2


@pytest.mark.parametrize("kind", GATEWAYS)
async def test_a_host_without_a_listener_is_a_port_error(kind):
    peer = peer_on(kind, None)
    peer.pull()
    client = GatewayClient(spec_of(peer, hub_servo()))
    with pytest.raises(PortError, match="cannot be reached"):
        await client.open()
    with pytest.raises(PortError):
        await client.exchange(VOLTAGE, WITHIN_S)
