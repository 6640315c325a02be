# SPDX-License-Identifier: Apache-2.0
"""Boards that read text: the line's very bytes on a pseudo-terminal."""

import asyncio
import contextlib
import os
import tty
from dataclasses import replace

import pytest
from loop_side import running, until
from text_board_rig import Reader, spec_of

from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    LineState,
    Mounting,
)
from motord_hal.realtime.exchange import Exchange


@pytest.fixture
def peer(tmp_path):
    peer = Reader(tmp_path / "board")
    yield peer
    peer.close()


async def test_duties_are_sent_as_the_classic_line_and_zeros_until_it_is_armed(peer):
    async with running(spec_of(peer.link, "{left:d},{right:d}\n")) as rig:
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5, 1: 1.0}
        await rig.ready()
        await until(lambda: len(peer.lines) > 10)
        assert set(peer.lines) == {b"0,0"}
        await rig.line.arm()
        await until(lambda: peer.lines[-1:] == [b"128,-255"])
        await rig.line.disarm()
        await until(lambda: peer.lines[-1:] == [b"0,0"])


async def test_a_new_set_point_does_not_wait_for_its_cycle(tmp_path):
    """The real-time engine sends it when it is woken. Of two boards with slow cycles, the one
    whose line is woken has its third set-point before the other."""
    template = "{left:d},{right:d}\n"
    with (
        contextlib.closing(Reader(tmp_path / "woken")) as woken,
        contextlib.closing(Reader(tmp_path / "waiting")) as waiting,
    ):
        async with (
            running(replace(spec_of(woken.link, template), cycle_hz=0.5)) as rig,
            running(replace(spec_of(waiting.link, template), index=1, cycle_hz=0.5)) as slow,
        ):
            await asyncio.gather(rig.arm(), slow.arm())
            for number in range(1, 4):
                for each in (rig, slow):
                    each.loop.enabled, each.loop.duty = True, {0: 0.2 * number, 1: 0.0}
                    each.loop.put()
                rig.loop.exchange.wake_line(0)
                line = b"%d,0" % (51 * number)
                await until(lambda line=line: woken.lines[-1:] == [line])
            assert b"153,0" not in waiting.lines
            await until(lambda: waiting.lines[-1:] == [b"153,0"])


async def test_a_board_may_get_the_speeds_of_the_base(peer):
    spec = spec_of(peer.link, "{v:.2f} {w:.2f}\n", drive="ascii-velocity")
    async with running(spec) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 1.0, 1: 3.0}
        await until(lambda: peer.lines[-1:] == [b"0.20 0.40"])
        rig.loop.running = False
        await until(lambda: peer.lines[-1] in (b"0.00 0.00", b"-0.00 -0.00", b"0.00 -0.00"))
        await until(lambda: rig.states() == {DriveState.READY})


async def test_the_last_line_that_is_sent_is_zero(tmp_path):
    peer = Reader(tmp_path / "board")
    async with running(spec_of(peer.link, "{left:d},{right:d}\n")) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: 0.5, 1: 1.0}
        await until(lambda: peer.lines[-1:] == [b"128,-255"])
    await until(lambda: peer.lines[-1:] == [b"0,0"])
    peer.close()


async def test_feedback_is_read_from_the_template_and_silence_is_seen(peer):
    feedback = "E {left_count} {right_count} {left_rad_s} {voltage_v}\n"
    async with running(spec_of(peer.link, "{left:d},{right:d}\n", feedback)) as rig:
        left = rig.loop.exchange.take_feedback

        def reported():
            peer.say(b"hello\nE -7 12 1.5 11.9\r\n")
            return left(0).stamp_ns > 0

        await until(reported)
        assert left(0).count == 0xFFFFFFF9
        assert left(1).count == 12
        assert left(0).velocity_rad_s == pytest.approx(1.5)
        assert left(1).velocity_rad_s != left(1).velocity_rad_s  # it was not reported
        assert left(0).voltage_v == pytest.approx(11.9)
        assert left(0).enabled is None
        assert rig.line.stats().errors["bad_reply"] >= 1
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "it sends nothing any more")
        assert EventKind.DRIVE_UNRESPONSIVE in rig.kinds()


async def test_a_rate_in_the_text_reaches_the_core_in_the_axes_of_the_base(peer):
    feedback = "{left_count} {gyro_z_rad_s}\n"
    spec = spec_of(peer.link, "{left:d},{right:d}\n", feedback)
    async with running(replace(spec, imu=Mounting(up="-z", forward="x"))) as rig:

        def reported():
            peer.say(b"\n12 0.25\n")
            return rig.loop.exchange.take_imu().stamp_ns > 0

        await until(reported)
        sample = rig.loop.exchange.take_imu()
        assert sample.angular_rad_s[2] == pytest.approx(-0.25)
        assert sample.angular_rad_s[0] != sample.angular_rad_s[0]


async def test_without_feedback_the_state_of_the_port_is_that_of_the_board(tmp_path):
    peer = Reader(tmp_path / "board")
    async with running(spec_of(peer.link, "{left:d},{right:d}\n")) as rig:
        await rig.arm()
        await until(lambda: rig.loop.exchange.take_feedback(0).stamp_ns > 0)
        peer.close()
        await until(lambda: rig.line.state is LineState.CLOSED)
        assert EventKind.LINE_LOST in rig.kinds()


async def test_a_board_that_a_dead_program_left_is_sent_zero_and_reported_as_unconfirmed(peer):
    """The board sends nothing; it is only known that the port has taken the bytes."""
    problems = await halt_line(spec_of(peer.link, "{left:d},{right:d}\n"))
    assert problems
    assert all("the drive cannot report whether it has power" in each for each in problems)
    assert len(peer.lines) > 10
    assert set(peer.lines) == {b"0,0"}


def test_a_template_that_leaves_a_joint_out_is_refused(tmp_path):
    spec = spec_of(tmp_path / "x", "{left:d}\n")
    with pytest.raises(ProfileError, match="it must contain left, right"):
        open_line(spec, Exchange.private(), print)


async def test_a_port_that_takes_no_more_bytes_does_not_block_the_event_loop(tmp_path):
    master, slave = os.openpty()
    tty.setraw(slave)
    padding = "." * 200
    spec = spec_of(os.ttyname(slave), f"{padding}{{left:d}},{{right:d}}\n")
    spec = replace(spec, baudrate=4_000_000, cycle_hz=1000.0)
    try:
        async with running(spec) as rig:
            await rig.arm()
            rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
            await until(lambda: rig.line.stats().errors.get("no_room", 0) > 10)
            rig.loop.enabled = False
            refused = rig.line.stats().errors["no_room"]
            await until(lambda: rig.line.stats().errors["no_room"] > refused + 10)
            await until(lambda: DriveState.ARMED not in rig.states())
        assert rig.events[-1].kind is EventKind.DRIVE_LEFT_ON
        assert "left, right not switched off at the end" in rig.events[-1].text
    finally:
        os.close(master)
        os.close(slave)
