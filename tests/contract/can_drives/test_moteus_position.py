# SPDX-License-Identifier: Apache-2.0
"""moteus in position mode, against a register server that follows mjbots' documents and goes to its
position at once."""

import math

import pytest
from loop_side import running, until
from scripted_moteus import ENABLING, POSITION, STOPPED, TIMEOUT, ZERO_VELOCITY, Moteus
from tests.shipped import shipped_profile

from motord_hal.fieldbus.ports import DriveState, JointSpec, LineSpec

NODES = (3, 9)
HERE_TURNS = -0.3125
RELATIVE, ROTOR, OUTPUT = 0, 1, 2
WATCHDOG_S = 2.0
SPEED_LIMIT_TURNS_S = 4.0


@pytest.fixture
def drives(address):
    drives = [Moteus(address, node) for node in NODES]
    for drive in drives:
        drive.values |= {0x001: HERE_TURNS, 0x00C: OUTPUT}
    yield drives
    for drive in drives:
        drive.close()
    assert not any(drive.bad for drive in drives)


@pytest.fixture
async def rig(drives, address):
    joints = tuple(
        JointSpec(
            index=index, name=f"joint_{node}", profile=shipped_profile("moteus-position"),
            unit=node, zero_count=-2048, position_velocity_rad_s=20.0,
        )
        for index, node in enumerate(NODES)
    )  # fmt: skip
    spec = LineSpec(
        index=0, name="can0", kind="can", port=address, baudrate=1_000_000, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine="rt", joints=joints,
        watchdog_s=WATCHDOG_S, data_baudrate=5_000_000,
    )  # fmt: skip
    async with running(spec) as rig:
        yield rig


async def more_commands(drive):
    came = len(drive.modes)
    await until(lambda: len(drive.modes) > came + 10)


async def test_before_it_has_power_its_target_is_its_own_position(rig, drives):
    await rig.ready()
    await more_commands(drives[0])
    drives[0].positions.clear()
    await more_commands(drives[0])
    assert set(drives[0].positions) == {(HERE_TURNS, STOPPED)}
    await rig.arm()
    rig.loop.enabled = True
    for drive in drives:
        powered = {place for place, mode in drive.positions if mode in (ENABLING, POSITION)}
        assert powered == {HERE_TURNS}, "arming moves nothing"
        assert drive.values[0x001] == HERE_TURNS


async def test_it_goes_to_its_angle_within_a_limit_of_speed_for_as_long_as_its_watchdog(
    rig, drives
):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5, 1: -0.5}
    wanted = [pytest.approx(-0.25 + angle / math.tau, abs=1e-6) for angle in (0.5, -0.5)]
    await rig.drive(lambda: [d.values[0x001] for d in drives] == wanted, "they are there")
    for drive in drives:
        assert drive.values[0x021] == 0.0
        assert drive.values[0x027] == pytest.approx(WATCHDOG_S)
        assert drive.values[0x028] == SPEED_LIMIT_TURNS_S


@pytest.mark.parametrize("state", [RELATIVE, ROTOR])
async def test_only_a_referenced_output_has_a_known_position(rig, drives, state):
    await rig.ready()

    def referenced():
        return [rig.loop.exchange.take_feedback(n).referenced for n in (0, 1)]

    await until(lambda: referenced() == [1, 1], "both are")
    drives[1].values[0x00C] = state
    await until(lambda: referenced() == [1, 0], "one is not any more")


async def test_old_set_points_stop_it_with_zero_velocity_and_then_without_power(rig, drives):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5, 1: 0.5}
    await rig.drive(lambda: drives[0].values[0x001] > HERE_TURNS, "it moves")
    rig.loop.running = False
    await until(lambda: all(drive.mode == STOPPED for drive in drives))
    for drive in drives:
        assert POSITION not in drive.modes[drive.modes.index(ZERO_VELOCITY) :]
    await until(lambda: rig.states() == {DriveState.READY})


async def test_the_watchdog_trips_on_a_silent_master(rig, drives):
    await rig.arm()
    rig.loop.position_rad = {0: 0.5, 1: 0.5}
    await rig.drive(lambda: drives[0].values[0x001] > HERE_TURNS, "it moves")
    drives[0].unreceptive = True
    await until(lambda: drives[0].mode == TIMEOUT)
    drives[0].unreceptive = False
    await until(lambda: drives[0].mode == STOPPED)
    assert drives[0].bites == 1
