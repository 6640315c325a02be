# SPDX-License-Identifier: Apache-2.0
"""Requests beside the cycle on serial lines of both engines: which reply belongs to which request,
and what waits for what."""

import asyncio
import contextlib

import pytest
from loop_side import GENEROUS_S, running, until
from modbus_rig import CONTROL, ENABLE, ENGINES, OFF, hub_servo, registers_of, spec_of
from scripted_slave import ScriptedSlave, Unit

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import HalError, NoReply
from motord_hal.fieldbus.ports import DriveState
from motord_hal.modbus.codec import Function, Request
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.line import AnswerKind, LineRequest, LineThread, ThreadSpec
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.modbus_frames import modbus_frame
from motord_hal.rt_engine.rs485.protocols import frames_of
from motord_hal.rt_engine.rs485.request_queue import RequestQueue
from motord_hal.rt_engine.rs485.table import line_table
from motord_hal.serial.port import open_port

TEMPERATURE = 0x20A4


@pytest.fixture(params=ENGINES)
async def peer(tmp_path, request):
    peer = ScriptedSlave(tmp_path / "port", engine=request.param)
    peer.units = {1: Unit(registers_of("zlac8015d")), 2: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


def two_drives():
    return (*hub_servo(1), *hub_servo(2, first=2))


@contextlib.asynccontextmanager
async def thread_on(peer):
    """Run the line's thread in C alone, on the peer's pty; its drives are not set up."""
    spec = spec_of(peer, two_drives())
    thread, notifier, port = LineThread(0, Exchange.private()), Notifier(), open_port(spec)
    notifier.open()
    try:
        place = ThreadSpec.of(spec, fd=port.fd, de_fd=port.de_fd, event_fd=notifier.event_fd)
        thread.start(place, line_table(spec, frames_of(spec)))
        yield thread, notifier
        thread.stop()
    finally:
        notifier.close()
        port.close()


def read_request(unit):
    return modbus_frame(Request(unit, Function.READ_HOLDING, TEMPERATURE, count=1))


def power_off_request(unit):
    return modbus_frame(Request(unit, Function.WRITE_SINGLE, CONTROL, values=(OFF,)))


@pytest.mark.parametrize("peer", ["rt"], indirect=True)
async def test_an_urgent_request_does_not_get_the_reply_of_the_one_on_the_wire(peer):
    peer.tricks.append(lambda request, honest: [(0.015, honest)])
    async with thread_on(peer) as (thread, _notifier):
        limit_ns = now_ns() + 10**10

        def put(number, drive, frame, urgent):
            request = LineRequest(
                id=number, drive=drive, frame=frame, expires_ns=limit_ns,
                turnaround_ns=20_000_000, urgent=urgent,
            )  # fmt: skip
            assert thread.put_request(request)

        put(1, 0, read_request(1), urgent=False)
        await until(lambda: len(peer.received) == 1)
        put(2, 1, power_off_request(2), urgent=True)
        answers = []

        def both_came():
            answers.extend(iter(thread.take_answer, None))
            return len(answers) == 2

        await until(both_came)
        assert [(one.id, one.kind) for one in answers] == [(1, AnswerKind.OK), (2, AnswerKind.OK)]
        assert [one.reply[0] for one in answers] == [1, 2]
        assert peer.written(CONTROL, unit=2) == [OFF]


async def test_disarming_two_drives_while_one_is_read_switches_both_off(peer):
    async with running(spec_of(peer, two_drives())) as rig:
        await rig.arm()
        mark = len(peer.received)

        def hold_the_read(request, honest):
            if (request.unit, request.address, request.count) == (1, TEMPERATURE, 1):
                return [(0.015, honest)]
            peer.tricks.append(hold_the_read)
            return [(0.0, honest)]

        peer.tricks.append(hold_the_read)
        reading = asyncio.create_task(rig.line.read_register("left1", "temperature_1"))
        await until(lambda: any(h.request.address == TEMPERATURE and h.request.count == 1
                                for h in peer.received[mark:]))  # fmt: skip
        async with asyncio.timeout(GENEROUS_S):
            await rig.line.disarm()
            await reading
        for unit in (1, 2):
            assert peer.written(CONTROL, unit)[-1] == OFF
        assert rig.states() == {DriveState.READY}


async def test_a_drive_that_does_not_answer_leaves_its_power_off_unconfirmed(peer):
    async with running(spec_of(peer, two_drives())) as rig:
        await rig.arm()
        peer.units[2].silent = True
        await until(lambda: DriveState.UNRESPONSIVE in rig.states())
        with pytest.raises(NoReply, match="left2, right2: no answer, so the power-off is not"):
            await rig.line.disarm()
        assert peer.written(CONTROL, 1)[-1] == OFF


async def test_continuous_reads_do_not_keep_the_drives_from_being_disarmed(peer):
    async with running(spec_of(peer, two_drives())) as rig:
        await rig.arm()
        reads = 0

        async def read_on(joint):
            nonlocal reads
            while True:
                with contextlib.suppress(HalError):
                    await rig.line.read_register(joint, "temperature_1")
                reads += 1

        tasks = [asyncio.create_task(read_on(name)) for name in ("left1", "right1", "left2")]
        await until(lambda: reads > 20)
        async with asyncio.timeout(GENEROUS_S):
            await rig.line.disarm()
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        for unit in (1, 2):
            assert peer.written(CONTROL, unit)[-1] == OFF


@pytest.mark.parametrize("peer", ["rt"], indirect=True)
async def test_a_request_that_an_urgent_one_overtakes_is_checked_again_before_it_is_sent(peer):
    """A power-on that waits for its turn is not sent after the power-off that overtook it."""
    async with thread_on(peer) as (thread, notifier):
        queue, allowed = RequestQueue("rs485", thread, 1.0), True

        def check():
            if not allowed:
                raise HalError("stopped")

        async def attend():
            while True:
                queue.take_answers()
                await notifier.wait()

        async def enable():
            frame = modbus_frame(Request(1, Function.WRITE_SINGLE, CONTROL, values=(ENABLE,)))
            with pytest.raises(HalError, match="stopped"):
                await queue.send(0, frame, 0.02, check=check)

        peer.tricks.append(lambda request, honest: [(0.015, honest)])
        async with asyncio.TaskGroup() as tasks:
            attending = tasks.create_task(attend())
            reading = tasks.create_task(queue.send(0, read_request(1), 0.02))
            await until(lambda: len(peer.received) == 1)
            enabling = tasks.create_task(enable())
            await asyncio.sleep(0)  # the power-on waits for its turn
            allowed = False
            await queue.send(0, power_off_request(1), 0.02, urgent=True)
            await reading
            await enabling
            attending.cancel()
        assert peer.written(CONTROL) == [OFF]
