# SPDX-License-Identifier: Apache-2.0
"""RoboClaws on the wire: which packets are sent, and when wheels are held or released."""

import asyncio
import os
import threading
import tty
from dataclasses import replace

import pytest
from loop_side import running, until

from motord.config.drives.load import find_profile
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, EventKind, JointSpec, LineSpec
from motord_hal.realtime.exchange import Exchange
from motord_hal.roboclaw.codec import build_reply, packet_bytes

SPEEDS, DUTIES, TIMEOUT, READ_TIMEOUT = 37, 34, 14, 15


class Controller:
    """A RoboClaw that answers all reads but the timeout with zeros."""

    def __init__(self, link):
        self.link = link
        self.packets = []
        self.mute = False
        self.timeout = 0
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self):
        tail = b""
        while True:
            tail += os.read(self.master, 4096)
            while (size := packet_bytes(tail)) is not None and len(tail) >= size:
                packet, tail = tail[:size], tail[size:]
                self._obey(packet)
            if tail.startswith(b"!!"):
                return

    def _obey(self, packet):
        self.packets.append(packet)
        if packet[1] == TIMEOUT:
            self.timeout = packet[2]
        words = (self.timeout,) if packet[1] == READ_TIMEOUT else (0, 0, 0, 0)
        if not self.mute:
            os.write(self.master, build_reply(packet, words))

    def sent(self, command):
        return [packet for packet in self.packets if packet[1] == command]

    def close(self):
        os.write(self._slave, b"!!")
        self._thread.join()
        os.close(self.master)
        os.close(self._slave)
        self.link.unlink()


@pytest.fixture
def peer(tmp_path):
    peer = Controller(tmp_path / "claw")
    yield peer
    peer.close()


def spec_of(port, drive="roboclaw"):
    profile = find_profile(drive)
    joints = tuple(
        JointSpec(index=n, name=name, profile=profile, unit=128, channel=n + 1)
        for n, name in enumerate(("left", "right"))
    )
    return LineSpec(
        index=0, name="claw", kind="roboclaw", port=str(port), baudrate=115200, parity="none",
        stop_bits=1, cycle_hz=50.0, gap_s=None, engine="auto", joints=joints, watchdog_s=0.5,
    )  # fmt: skip


async def test_its_timeout_is_read_back_and_it_gets_duties_alone_until_it_is_armed(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.ready()
        assert peer.timeout == 5
        assert peer.sent(READ_TIMEOUT)
        await until(lambda: len(peer.sent(DUTIES)) > 5)
        assert not peer.sent(SPEEDS)
        assert {packet[2:6] for packet in peer.sent(DUTIES)} == {bytes(4)}


async def test_speeds_are_sent_in_edges_a_second_and_zero_is_held_while_armed(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.arm()
        rig.loop.enabled = True
        await until(lambda: peer.sent(SPEEDS))
        assert peer.sent(SPEEDS)[-1][2:10] == bytes(8)
        turn_rad_s = 6.283185307179586
        rig.loop.velocity_rad_s = {0: turn_rad_s, 1: -turn_rad_s}
        wanted = (1320).to_bytes(4, "big") + (-1320).to_bytes(4, "big", signed=True)
        await until(lambda: peer.sent(SPEEDS)[-1][2:10] == wanted)
        await rig.line.disarm()
        held = len(peer.sent(SPEEDS))
        free = len(peer.sent(DUTIES))
        await until(lambda: len(peer.sent(DUTIES)) > free + 5)
        assert len(peer.sent(SPEEDS)) == held


async def test_a_second_motor_alone_also_gets_no_speeds_until_it_is_armed(peer):
    spec = spec_of(peer.link)
    async with running(replace(spec, joints=spec.joints[1:])) as rig:
        await rig.ready()
        await until(lambda: len(peer.sent(DUTIES)) > 10)
        assert not peer.sent(SPEEDS)
        await rig.arm()
        await until(lambda: peer.sent(SPEEDS))


async def test_a_mute_controller_is_unresponsive_and_comes_back_disarmed(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.arm()
        peer.mute = True
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})
        peer.mute = False
        await until(lambda: rig.states() == {DriveState.READY})
        assert EventKind.DRIVE_BACK in rig.kinds()


async def test_a_late_answer_is_not_taken_for_another_request_s(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.ready()
        seen = rig.line.stats().exchanges
        for _ in range(5):
            os.write(peer.master, b"\xff\xff\xff")
            await asyncio.sleep(0.01)
        await until(lambda: rig.line.stats().exchanges > seen + 50)
        assert rig.states() == {DriveState.READY}
        feedback = rig.loop.exchange.take_feedback(0)
        assert feedback.count == 0
        assert feedback.drive_faults == 0


async def test_a_controller_that_a_dead_program_left_turning_is_stopped_and_released(peer):
    problems = await halt_line(spec_of(peer.link))
    assert problems == []
    assert peer.sent(SPEEDS)[0][2:10] == bytes(8)
    assert peer.packets[-1][1] == DUTIES
    assert peer.packets[-1][2:6] == bytes(4)


def test_a_drive_of_another_protocol_is_refused(tmp_path):
    with pytest.raises(ProfileError, match="speaks modbus-rtu"):
        open_line(spec_of(tmp_path / "x", "zlac8015d"), Exchange.private(), print)


async def test_a_speed_is_not_held_by_a_controller_that_was_stopped(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: 3.0, 1: 3.0}
        await until(lambda: any(packet[2:10] != bytes(8) for packet in peer.sent(SPEEDS)))
        rig.loop.running = False
        await until(lambda: rig.states() == {DriveState.READY})
        rig.loop.running = True
        free = len(peer.sent(DUTIES))
        await until(lambda: len(peer.sent(DUTIES)) > free + 5, "at rest it is released")
        held = len(peer.sent(SPEEDS))
        await until(lambda: len(peer.sent(DUTIES)) > free + 20)
        assert len(peer.sent(SPEEDS)) == held
        assert peer.sent(SPEEDS)[-1][2:10] == bytes(8)


async def test_registers_are_read_in_their_own_width(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.ready()
        assert await rig.line.read_register("left", "communication_timeout") == pytest.approx(0.5)
        assert await rig.line.read_register("right", "main_battery") == 0.0


async def test_a_timeout_that_was_lost_is_set_again_disarmed(peer):
    async with running(spec_of(peer.link)) as rig:
        await rig.arm()
        peer.timeout = 0  # it had no power for a moment
        await until(lambda: peer.timeout == 5)
        await until(lambda: rig.states() == {DriveState.READY})
        assert EventKind.DRIVE_WARNING in rig.kinds()
