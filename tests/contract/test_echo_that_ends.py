# SPDX-License-Identifier: Apache-2.0
"""An adapter that hears itself for a while only: a loose transceiver, a plug put in elsewhere."""

import pytest
from loop_side import running, until
from scripted_slave import ScriptedSlave, Unit
from test_modbus_line import ENGINES, hub_servo, registers_of, spec_of

from motord_hal.modbus.codec import Function, build_request


@pytest.fixture(params=ENGINES)
async def peer(tmp_path, request):
    peer = ScriptedSlave(tmp_path / "port", engine=request.param)
    peer.units = {1: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


def echo(peer, until=lambda request: False):
    """From now on whatever is sent comes back before the reply; `until` says which is the last."""

    def both(request, honest):
        if not until(request):
            peer.tricks.append(both)
        return [(0.0, build_request(request) + honest)]

    peer.tricks.append(both)


async def test_a_line_that_does_not_echo_any_more_is_heard_again(peer):
    echo(peer)
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.ready()
        peer.tricks.clear()
        heard = len(peer.heard)
        await until(lambda: len(peer.heard) > heard + 20, "it goes on asking")
        await rig.arm()


async def test_an_echo_that_ends_while_the_drives_are_set_up_is_given_up_again(peer):
    echo(peer, until=lambda request: request.function is Function.READ_HOLDING)
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.arm()


async def test_a_line_that_begins_to_echo_is_heard_all_the_same(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.ready()
        echo(peer)
        await rig.arm()
