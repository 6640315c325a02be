# SPDX-License-Identifier: Apache-2.0
"""An adapter that receives its own bytes only for a while: a loose transceiver, another socket."""

import pytest
from loop_side import running, until
from modbus_rig import ENGINES, hub_servo, registers_of, spec_of
from scripted_slave import ScriptedSlave, Unit

from motord_hal.fieldbus.ports import DriveState, Echo
from motord_hal.modbus.codec import Function, Request, build_request
from motord_hal.modbus.guard import StrictFramer


@pytest.fixture(params=ENGINES)
async def peer(tmp_path, request):
    peer = ScriptedSlave(tmp_path / "port", engine=request.param)
    peer.units = {1: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


def echo(peer, until=lambda request: False):
    """From now on echo each request before its reply, up to the one for which `until` is true."""

    def both(request, honest):
        if not until(request):
            peer.tricks.append(both)
        return [(0.0, build_request(request) + honest)]

    peer.tricks.append(both)


async def test_a_line_that_stops_echoing_is_read_again(peer):
    echo(peer)
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.ready()
        peer.tricks.clear()
        received = len(peer.received)
        await until(lambda: len(peer.received) > received + 20, "it keeps sending requests")
        await rig.arm()


async def test_an_echo_that_ends_while_the_drives_are_set_up_does_not_prevent_arming(peer):
    echo(peer, until=lambda request: request.function is Function.READ_HOLDING)
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.arm()


async def test_a_line_that_begins_to_echo_is_still_read(peer):
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.ready()
        echo(peer)
        await rig.arm()


async def test_an_echo_does_not_count_as_the_acknowledgement_of_a_dead_drive(peer):
    """The adapter receives its own bytes. When the drive dies, only the echo is left."""
    echo(peer)
    async with running(spec_of(peer, hub_servo())) as rig:
        await rig.ready()

        def only_echo(request, honest):
            peer.tricks.append(only_echo)
            return [(0.0, build_request(request))]

        peer.tricks.clear()
        peer.tricks.append(only_echo)
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "it is unresponsive")
        received = len(peer.received)
        await until(lambda: len(peer.received) > received + 5, "it is probed")
        assert rig.states() == {DriveState.UNRESPONSIVE}


@pytest.mark.parametrize(("echo_setting", "acknowledged"), [(Echo.YES, False), (Echo.NO, True)])
async def test_the_robot_file_decides_whether_the_line_echoes(echo_setting, acknowledged):
    """When one register is written, echo and reply are equal. Only asyncio's framer is tested."""
    framer = StrictFramer(echo_setting)
    request = Request(1, Function.WRITE_SINGLE, 0x200E, values=(8,))
    frame = build_request(request)
    framer.arm(request)
    framer.handleFrame(frame, 1, 0)
    assert (framer.reply is not None) is acknowledged
    framer.arm(request)
    framer.handleFrame(frame + frame, 1, 0)
    assert framer.reply is not None
