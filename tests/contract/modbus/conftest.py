# SPDX-License-Identifier: Apache-2.0
"""Lines of both engines over all media, with scripted slaves as their drives."""

import pytest
from loop_side import running
from modbus_rig import ENGINES, hub_servo, registers_of, spec_of
from scripted_gateway import GATEWAYS, peer_on
from scripted_slave import Unit


@pytest.fixture(params=[*ENGINES, *GATEWAYS])
async def peer(tmp_path, request):
    peer = peer_on(request.param, tmp_path)
    peer.units = {1: Unit(registers_of("zlac8015d")), 2: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        yield rig
