# SPDX-License-Identifier: Apache-2.0
"""Guarantee of the board lines in C: no action and no delay of asyncio moves a motor."""

import time

from frame_board_rig import spec_of as frames_spec
from loop_side import PATIENT_S, running, until
from text_board_rig import Reader
from text_board_rig import spec_of as text_spec

from motord_hal.base.clock import now_ns
from motord_hal.fieldbus.ports import DriveState
from motord_hal.realtime.exchange import JointSetpoint, Setpoints

TURN_RAD_S = 3.0
NEVER_S = 60.0
"""Watchdog time that is longer than any test waits."""


def sleep_until(condition):
    """Wait as `until` does, but keep the event loop blocked."""
    end_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.002)


def core_alone(loop, ticks):
    """Put new set-points every 10 ms as a live core does; return the longest pause in ns."""
    longest_ns = 0
    for tick in range(ticks):
        before_ns, loop.put_ns = loop.put_ns, now_ns()
        longest_ns = max(longest_ns, loop.put_ns - before_ns)
        wheels = tuple(JointSetpoint(TURN_RAD_S + tick, 0.0) for _ in range(8))
        core = Setpoints(loop.put_ns, tick, enabled=True, joints=wheels)
        loop.exchange.put_setpoints(0, core)
        time.sleep(0.01)
    return longest_ns


async def turning(rig, peer):
    await rig.arm()
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN_RAD_S, 1: TURN_RAD_S}
    await until(lambda: peer.now.left_mrad_s == round(TURN_RAD_S * 1000), "it turns")


async def test_an_event_loop_that_hangs_does_not_keep_a_motor_turning(peer):
    async with running(frames_spec(peer, watchdog_s=NEVER_S)) as rig:
        await turning(rig, peer)
        seen = len(peer.sent)
        sleep_until(lambda: not peer.now.enabled and not peer.now.braking)
        assert any(sent.braking for sent in peer.sent[seen:])
        await until(lambda: rig.states() == {DriveState.READY})


async def test_a_core_that_clears_enabled_takes_the_power_while_the_event_loop_hangs(peer):
    async with running(frames_spec(peer, watchdog_s=2.0)) as rig:
        await turning(rig, peer)
        seen = len(peer.sent)
        rig.loop.enabled = False
        rig.loop.put()
        sleep_until(lambda: not peer.now.enabled)
        assert not any(sent.braking for sent in peer.sent[seen:])


async def test_a_live_core_drives_the_board_while_the_event_loop_hangs(peer):
    async with running(frames_spec(peer, watchdog_s=1.0)) as rig:
        await turning(rig, peer)
        seen = len(peer.sent)
        longest_ns = core_alone(rig.loop, 150)
        sent = peer.sent[seen:]
        assert len({one.left_mrad_s for one in sent}) > 10
        assert all(one.enabled for one in sent) or longest_ns > 0.5e9 * PATIENT_S


async def test_a_text_board_is_sent_zero_while_the_event_loop_hangs(tmp_path):
    peer = Reader(tmp_path / "board")
    async with running(text_spec(peer.link, "{left:d},{right:d}\n")) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5, 1: 1.0}
        await until(lambda: peer.lines[-1:] == [b"128,-255"])
        sleep_until(lambda: peer.lines[-6:] == [b"0,0"] * 6)
    peer.close()


async def test_feedback_reaches_the_core_while_the_event_loop_hangs(peer):
    async with running(frames_spec(peer)) as rig:
        await rig.ready()
        first = rig.loop.exchange.take_feedback(0).stamp_ns
        sleep_until(lambda: rig.loop.exchange.take_feedback(0).stamp_ns > first + 100_000_000)


async def test_its_trace_keeps_frames_of_both_directions(peer):
    async with running(frames_spec(peer)) as rig:
        await rig.ready()
        trace = rig.line.trace
        trace.switch(on=True)
        await until(lambda: {one.outward for one in trace.after(0)} == {True, False})
        trace.switch(on=False)
        assert all(entry.data for entry in trace.after(0))
