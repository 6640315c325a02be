# SPDX-License-Identifier: Apache-2.0
"""Serial lines against drives that answer late, refuse, or lose replies: how old values are, and
what is reported of a drive that is unresponsive."""

import asyncio
import random
import time
from collections import deque

import pytest
from loop_side import running, until
from modbus_rig import ENGINES, POSITION_1, hub_servo, registers_of, spec_of
from scripted_slave import ScriptedSlave, Unit

from motord_hal.fieldbus.ports import EventKind
from motord_hal.modbus.codec import Function, build_reply

TICK_NS = 10_000
CYCLE_NS = 20_000_000


@pytest.fixture(params=ENGINES)
async def peer(tmp_path, request):
    peer = ScriptedSlave(tmp_path / "port", engine=request.param)
    peer.units = {1: Unit(registers_of("zlac8015d"))}
    yield peer
    peer.pull()


def answer_late(peer, late_s, part, seed=1):
    """From now on report the time as the position, and delay this part of the replies. They keep
    the order of the requests, as a drive's do: each timer sends the reply that has waited longest,
    because two timers of asyncio that are due at nearly one time may run in either order."""
    chance = random.Random(seed)
    answered_s = 0.0
    waiting = deque()

    def reply(request, honest):
        nonlocal answered_s
        peer.tricks.append(reply)
        if request.function is Function.READ_HOLDING:
            registers = peer.units[request.unit].registers
            ticks = time.monotonic_ns() // TICK_NS
            registers[POSITION_1], registers[POSITION_1 + 1] = ticks >> 16 & 0xFFFF, ticks & 0xFFFF
            span = range(request.address, request.address + request.count)
            honest = build_reply(request, tuple(registers[address] for address in span))
        now_s = time.monotonic()
        answered_s = max(answered_s, now_s + (late_s if chance.random() < part else 0.0))
        waiting.append(honest)
        peer.later(answered_s - now_s, lambda: peer.send(waiting.popleft()))
        return []

    peer.tricks.clear()
    peer.tricks.append(reply)


def age_ns(feedback):
    """Return how much older the feedback's position is than its stamp."""
    behind = (feedback.stamp_ns // TICK_NS - feedback.count) & 0xFFFFFFFF
    return (behind - (1 << 32) if behind >> 31 else behind) * TICK_NS


@pytest.mark.parametrize("peer", ["rt"], indirect=True)
@pytest.mark.parametrize("late_ms", [5, 30, 60, 100])
async def test_no_position_is_older_than_its_stamp(peer, late_ms):
    async with running(spec_of(peer, hub_servo(), cycle_hz=50.0), in_haste=True) as rig:
        await rig.ready()
        answer_late(peer, 0.0, 0.0)
        mark = len(peer.received)
        await until(lambda: len(peer.received) > mark + 10)
        answer_late(peer, late_ms / 1e3, 0.3)
        ages_ns, mark = {}, len(peer.received)
        while len(peer.received) < mark + 150:
            feedback = rig.loop.exchange.take_feedback(0)
            if feedback.stamp_ns:
                ages_ns[feedback.stamp_ns] = age_ns(feedback)
            await asyncio.sleep(0.001)
        assert ages_ns
        assert max(ages_ns.values()) <= CYCLE_NS


async def why_unresponsive(rig):
    await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds())
    return next(event.text for event in rig.events if event.kind is EventKind.DRIVE_UNRESPONSIVE)


async def test_a_drive_that_refuses_is_not_reported_as_another_baud_rate(peer):
    async with running(spec_of(peer, hub_servo()), in_haste=True) as rig:
        await rig.ready()
        peer.units[1].refuses = set(peer.units[1].registers)
        text = await why_unresponsive(rig)
        assert "exception 2" in text
        assert "baud" not in text


async def test_lost_replies_are_not_reported_as_another_baud_rate(peer):
    async with running(spec_of(peer, hub_servo()), in_haste=True) as rig:
        await rig.ready()
        peer.units[1].silent = True
        text = await why_unresponsive(rig)
        assert "nothing within" in text
        assert "baud" not in text


async def test_torn_replies_among_good_ones_are_reported_as_torn(peer):
    async with running(spec_of(peer, hub_servo()), in_haste=True) as rig:
        await rig.ready()

        def tear(_request, honest):
            peer.tricks.append(tear)
            return [(0.0, honest[:4])]

        peer.tricks.append(tear)
        text = await why_unresponsive(rig)
        assert "torn or damaged replies" in text
        assert "bytes came, but no frame" not in text


async def test_a_drive_that_answers_late_is_reported_as_slow(peer):
    async with running(spec_of(peer, hub_servo()), in_haste=True) as rig:
        await rig.ready()
        answer_late(peer, 0.04, 1.0)
        text = await why_unresponsive(rig)
        assert "replies come after their time" in text
        assert "baud" not in text


async def test_bytes_that_never_form_a_frame_hint_at_the_baud_rate(peer):
    def garble(_request, honest):
        peer.tricks.append(garble)
        return [(0.0, bytes(byte ^ 0x5A for byte in honest))]

    peer.tricks.append(garble)
    async with running(spec_of(peer, hub_servo()), in_haste=True) as rig:
        assert "bytes came, but no frame: baud rate or parity?" in await why_unresponsive(rig)
