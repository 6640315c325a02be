# SPDX-License-Identifier: Apache-2.0
"""Encoders on a board of one's own beside bridges on pins: the line against the reference board,
compiled for this machine."""

import math

import pytest
from loop_side import running, until
from mcu_peer import McuPeer
from pwm_rig import PERIOD_NS, armed, spec_of

from motord.config.drives.load import find_profile
from motord_hal.base.clock import now_ns
from motord_hal.fieldbus.ports import BoardEncoder, DriveState, EventKind, JointSpec

PER_COUNT = math.tau / 1320
BY_HAND_RAD_S = 4.0


@pytest.fixture
async def rig(peer, chip):
    async with running(line_with(peer, chip)) as rig:
        await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "the board counts")
        yield rig


def line_with(peer, chip):
    """Return a line whose left encoder counts down when its wheel turns forward."""
    profile, port = find_profile("bts7960"), str(peer.link)
    joints = tuple(
        JointSpec(
            index=number,
            name=name,
            profile=profile,
            unit=number + 1,
            pins={"rpwm": f"pwm{2 * number}", "lpwm": f"pwm{2 * number + 1}"},
            encoder=BoardEncoder(
                port=port, baudrate=115200, motor=number + 1, rad_per_count=sign * PER_COUNT
            ),
        )
        for number, (name, sign) in enumerate((("left", -1.0), ("right", 1.0)))
    )
    return spec_of(chip, joints=joints)


def feedback_of(rig, joint=0):
    return rig.loop.exchange.take_feedback(joint)


def count_of(rig):
    """Return the count of the left wheel as a signed number."""
    count = feedback_of(rig).count
    return count - (1 << 64) if count >> 63 else count


async def test_a_wheel_that_turns_is_reported_with_count_speed_and_stamp(rig, peer):
    assert (count_of(rig), feedback_of(rig).velocity_rad_s) == (0, 0.0)
    peer.do("t")
    await until(lambda: count_of(rig) < -200, "it turns")
    await until(lambda: feedback_of(rig).velocity_rad_s == pytest.approx(BY_HAND_RAD_S, rel=0.2))
    first = feedback_of(rig)
    assert 0 < first.stamp_ns <= now_ns()
    assert feedback_of(rig, 1).count == 0
    await until(lambda: feedback_of(rig).stamp_ns > first.stamp_ns)
    peer.do("s")
    await until(lambda: feedback_of(rig).velocity_rad_s == 0.0, "the wheel stands")


async def test_a_board_that_only_counts_is_never_enabled_even_when_the_bridges_are(rig, peer, chip):
    await armed(rig)
    rig.loop.enabled, rig.loop.duty = True, {0: 0.5}
    await until(lambda: chip.duties()[0] == PERIOD_NS // 2)
    stamp_ns = feedback_of(rig).stamp_ns
    await until(lambda: feedback_of(rig).stamp_ns > stamp_ns + 50_000_000)
    assert not any(sent.enabled for sent in peer.sent)


async def test_the_feedback_of_a_silent_board_gets_old_and_the_board_is_reported_once(rig, peer):
    peer.do("m")
    await until(lambda: EventKind.DRIVE_WARNING in rig.kinds(), "it is reported")
    assert "left, right" in rig.events[-1].text
    assert "the encoder board is silent" in rig.events[-1].text
    old = feedback_of(rig).stamp_ns
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 20)
    assert feedback_of(rig).stamp_ns == old
    assert rig.states() == {DriveState.READY}  # the pins are as they were; the core judges the age
    peer.do("w")
    await until(lambda: feedback_of(rig).stamp_ns > old, "it counts again")
    assert rig.kinds().count(EventKind.DRIVE_WARNING) == 1
    assert rig.kinds().count(EventKind.DRIVE_BACK) == 2


async def test_a_restarted_board_is_a_new_origin_and_no_motion(rig, peer):
    peer.do("t")
    await until(lambda: count_of(rig) < -100)
    peer.do("s")
    await until(lambda: feedback_of(rig).velocity_rad_s == 0.0)
    before, epoch = count_of(rig), feedback_of(rig).epoch
    peer.do("r")
    await until(lambda: feedback_of(rig).epoch > epoch, "a new epoch")
    assert count_of(rig) == before


async def test_a_board_that_is_unplugged_and_plugged_in_is_found_again(program, peer, chip):
    async with running(line_with(peer, chip)) as rig:
        await until(lambda: feedback_of(rig).stamp_ns > 0)
        peer.pull()
        await until(lambda: EventKind.DRIVE_WARNING in rig.kinds(), "it is reported")
        old = feedback_of(rig).stamp_ns
        again = McuPeer(program, peer.link)
        await until(lambda: feedback_of(rig).stamp_ns > old, "it counts again")
    again.pull()
