# SPDX-License-Identifier: Apache-2.0
"""Sabertooths in packet serial mode: motord's packets beside those of pysabertooth, which drives
the simulated one, too."""

import contextlib
import os
import tty
from dataclasses import replace

import pytest
from loop_side import running, until
from pysabertooth import Sabertooth
from sim_bench import simulated
from sim_bench import spec_of as bench_spec_of

from motord.config.drives.load import find_profile
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, JointSpec, LineSpec
from motord_hal.realtime.exchange import Exchange

UNIT, OTHER = 130, 131


def packet(unit, command, value):
    return bytes((unit, command, value, (unit + command + value) & 127))


TIMEOUT = packet(UNIT, 14, 3)
"""Packet that sets the time-out to 0.3 s."""


SINGLE = replace(find_profile("sabertooth"), channels={1: find_profile("sabertooth").channels[1]})
"""Profile of a driver for one motor: a robot with two wheels has two of them, at 128 and 129."""
OTHER_PROFILE = replace(SINGLE, name="other")


@pytest.fixture
def port():
    """Both ends of a pty: what is written to the second one is read from the first."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def taken(master):
    with contextlib.suppress(BlockingIOError):
        return os.read(master, 65536)
    return b""


def spec_of(path, watchdog_s=0.3, places=((UNIT, 1), (UNIT, 2))):
    """Return the line; `places` has unit and channel of each joint."""
    profile = find_profile("sabertooth")
    joints = tuple(
        JointSpec(index=index, name=f"wheel{index}", profile=profile, unit=unit, channel=channel)
        for index, (unit, channel) in enumerate(places)
    )
    return LineSpec(
        index=0, name="saber", kind="sabertooth", port=path, baudrate=9600, parity="none",
        stop_bits=1, cycle_hz=50.0, gap_s=None, engine="auto", joints=joints,
        watchdog_s=watchdog_s, priority=0,
    )  # fmt: skip


@contextlib.contextmanager
def sabertooth(path, address):
    """Yield pysabertooth's driver, and close it here: its __del__ would do so at any time."""
    saber = Sabertooth(path, baudrate=9600, address=address)
    try:
        yield saber
    finally:
        saber.stop()
        saber.close()
        saber.stop = saber.close = lambda: None


async def all_of(master, count):
    """Read at least this many bytes, which a pty delivers a moment later."""
    seen = b""

    def complete():
        nonlocal seen
        seen += taken(master)
        return len(seen) >= count

    await until(complete, f"{count} bytes")
    return seen


@pytest.mark.parametrize(("left", "right"), [(100, 100), (-100, 100), (0, -100), (100, 0), (0, 0)])
async def test_packets_are_those_of_pysabertooth_after_the_time_out(port, left, right):
    master, path = port
    with sabertooth(path, UNIT) as saber:
        taken(master)
        saber.driveBoth(left, right)
        packets = await all_of(master, 8)
    taken(master)
    expected = TIMEOUT + packets
    seen = b""
    async with running(spec_of(path)) as rig:
        await rig.arm()
        rig.loop.enabled, rig.loop.duty = True, {0: left / 100, 1: right / 100}

        def sent():
            nonlocal seen
            seen += taken(master)
            return 2 * expected in seen

        await rig.drive(sent, "the same packets")


async def test_two_drivers_on_one_wire_get_the_packets_that_pysabertooth_sends_to_two(port):
    master, path = port
    with sabertooth(path, UNIT) as one, sabertooth(path, OTHER) as other:
        taken(master)
        one.driveBoth(0, 100)
        first = await all_of(master, 8)
        other.driveBoth(-100, 0)
        expected = TIMEOUT + first + packet(OTHER, 14, 3) + await all_of(master, 8)
    taken(master)
    seen = b""
    spec = spec_of(path, places=((OTHER, 1), (UNIT, 2)))
    still = b"".join(packet(unit, *zero) for unit in (UNIT, OTHER) for zero in ((0, 0), (4, 0)))
    async with running(spec) as rig:
        rig.loop.enabled, rig.loop.duty = True, {0: -1.0, 1: 1.0}

        def sent():
            nonlocal seen
            seen += taken(master)
            return 2 * expected in seen

        await rig.drive(sent, "the same packets")
        rig.loop.enabled = False
        await until(lambda: rig.states() == {DriveState.READY}, "not enabled any more")
        seen = b""

        def is_still():
            nonlocal seen
            seen += taken(master)
            without = seen.replace(TIMEOUT, b"").replace(packet(OTHER, 14, 3), b"")
            return still in without[-len(still) :]

        await until(is_still, "both are sent zero")


async def test_drivers_of_two_profiles_on_one_wire_are_refused(port):
    _, path = port
    spec = spec_of(path, places=((UNIT, 1), (OTHER, 1)))
    joints = (spec.joints[0], replace(spec.joints[1], profile=OTHER_PROFILE))
    with pytest.raises(ProfileError, match="the same profile"):
        open_line(replace(spec, joints=joints), Exchange.private(), print)


async def test_only_zeros_and_the_time_out_are_sent_before_arming_and_at_the_end(port):
    master, path = port
    zeros = bytes((UNIT, 0, 0, UNIT & 127, UNIT, 4, 0, (UNIT + 4) & 127))
    seen = b""

    def watch():
        nonlocal seen
        seen += taken(master)
        return len(seen) > 300

    async with running(spec_of(path)) as rig:
        rig.loop.enabled, rig.loop.duty = True, {0: 1.0, 1: 1.0}
        await rig.ready()
        await until(watch)
        assert seen.replace(TIMEOUT, b"").replace(zeros, b"") == b""
        await rig.line.arm()
        await until(lambda: watch() and b"\x82\x00\x7f" in seen, "full duty")
        taken(master)
        rig.loop.running = False
        await until(lambda: rig.states() == {DriveState.READY}, "old set-points stop it")
    seen = b""
    watch()
    assert seen.endswith(zeros)


async def test_a_driver_that_a_dead_program_left_is_sent_zeros_and_reported_as_unconfirmed(port):
    master, path = port
    (problem,) = set(await halt_line(spec_of(path)))
    assert "the stop was sent; the drive cannot report whether it has power" in problem
    seen = taken(master)
    assert len(seen) > 80
    assert set(seen) <= {UNIT, 0, 4, UNIT & 127, (UNIT + 4) & 127}


async def test_pysabertooth_drives_the_simulated_driver_until_its_time_out(tmp_path):
    profile = replace(find_profile("sabertooth"), baudrate=9600)
    with simulated(profile, tmp_path) as sim, sabertooth(str(tmp_path / "bus"), 128) as saber:

        def speeds():
            return [joint.velocity_rad_s for joint in sim.truth().joints.values()]

        def bites():
            return sim.stats()["lines"]["bus"]["units"]["128"]["watchdog_bites"]

        def turn():
            saber.driveBoth(60, 60)  # the right motor is mounted in reverse
            left, right = speeds()
            return left > 2.0 and right < -2.0

        await until(turn, "both turn")
        saber.stop()
        await until(lambda: sim.truth().at_rest, "zero stops them")
        assert bites() == 0
        saber.sendCommand(14, 5)  # half a second
        await until(turn, "both turn")
        await until(lambda: sim.truth().at_rest, "silence stops them")
        assert bites() == 1


async def test_each_of_two_simulated_drivers_on_one_wire_takes_its_own_packets(tmp_path):
    with simulated(SINGLE, tmp_path) as sim, sabertooth(str(tmp_path / "bus"), 129) as right:

        def speeds():
            return [joint.velocity_rad_s for joint in sim.truth().joints.values()]

        def turn():
            right.drive(1, 60)
            return speeds()[1] < -2.0

        await until(turn, "the one at 129 turns")
        assert speeds()[0] == 0.0


async def test_two_simulated_drivers_on_one_wire_drive_a_robot_and_stop_by_their_time_out(tmp_path):
    with simulated(SINGLE, tmp_path) as sim:

        def speeds():
            return [joint.velocity_rad_s for joint in sim.truth().joints.values()]

        def bites():
            units = sim.stats()["lines"]["bus"]["units"]
            return [units[unit]["watchdog_bites"] for unit in ("128", "129")]

        async with running(bench_spec_of(SINGLE, tmp_path)) as rig:
            rig.loop.duty = {0: 0.5, 1: -0.5}
            await rig.drive(lambda: speeds()[0] > 1.0 and speeds()[1] < -1.0, "both turn")
            await rig.line.disarm()
            await until(lambda: sim.truth().at_rest, "zero stops both")
        assert bites() == [0, 0]
        await until(lambda: bites() == [1, 1], "each has the time-out")


async def test_packets_for_another_address_or_with_a_wrong_check_sum_move_nothing(tmp_path):
    with simulated(find_profile("sabertooth"), tmp_path) as sim:
        with sabertooth(str(tmp_path / "bus"), 129) as other:
            for _ in range(20):
                other.driveBoth(100, 100)
                other.saber.write(bytes((128, 0, 100, 0)))  # 100 would be its right check sum
            frames = sim.stats()["lines"]["bus"]
            await until(lambda: sim.stats()["lines"]["bus"]["bad_crc"] >= 20, "they have come")
            assert frames["frames"] >= 0
        assert sim.truth().moved_max_m_s == 0.0
