# SPDX-License-Identifier: Apache-2.0
"""Another node that sends what only motord may send is noticed, and reported with its identifier
and the drive that obeys it."""

import struct

import pytest
from can_rig import spec_of
from loop_side import running, until
from scripted_odrive import BUSES, ESTIMATES, INPUT_VELOCITY, STATE, Peer, living

from motord_hal.fieldbus.ports import EventKind

NODE = 3


@pytest.fixture(params=BUSES)
async def peer(request):
    async with living(Peer(request.param, nodes=(0, NODE))) as peer:
        yield peer


@pytest.fixture
async def rig(peer):
    async with running(spec_of(peer, 0, NODE)) as rig:
        await rig.ready()
        yield rig


def warnings(rig):
    return [event.text for event in rig.events if event.kind is EventKind.DRIVE_WARNING]


def foreign(rig):
    return rig.line.stats().errors.get("foreign", 0)


async def test_a_second_sender_of_a_set_point_is_counted_and_reported_once(rig, peer):
    number = NODE << 5 | INPUT_VELOCITY
    for _ in range(5):
        peer.send_raw(number, struct.pack("<ff", 5.0, 0.0))
    await until(lambda: foreign(rig) == 5 and warnings(rig))
    (text,) = warnings(rig)
    assert "another node sends identifier 0x06d (11 bits): set_input_velocity" in text
    assert f'"odrive-0.5" node {NODE} (joint wheel{NODE})' in text
    peer.send_raw(NODE << 5 | STATE, struct.pack("<I", 8))
    await until(lambda: len(warnings(rig)) == 2)
    assert "set_axis_state" in warnings(rig)[1]
    assert foreign(rig) == 6


async def test_a_second_one_that_requests_what_motord_requests_is_reported_too(rig, peer):
    peer.send_raw(NODE << 5 | ESTIMATES, None, is_remote_frame=True, dlc=8)
    await until(lambda: foreign(rig) == 1 and warnings(rig))
    assert "the request of encoder_estimates" in warnings(rig)[0]


async def test_motord_and_its_drives_are_no_second_senders(rig, peer):
    await rig.arm()
    peer.send_raw(5 << 5 | INPUT_VELOCITY, struct.pack("<ff", 5.0, 0.0))  # to no drive of motord
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 30)
    await rig.line.disarm()
    assert foreign(rig) == 0
    assert warnings(rig) == []
