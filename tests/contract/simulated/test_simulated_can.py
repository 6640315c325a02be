# SPDX-License-Identifier: Apache-2.0
"""CAN lines against simulated drives with faults: no wheel turns without a command."""

import asyncio
import contextlib

import pytest
from loop_side import until
from sim_bench import RT, with_rt, without_power
from tests.long_cases import long_but
from tests.shipped import shipped_profile

from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import DriveState, EventKind

SPEED_RAD_S = 3.0
LOSSY = ["odrive-0.6", "vesc", "rmd", "dbc-example", "moteus"]
"""Drives whose set-up tolerates lost frames; the others' SDO transfers are not retried at once."""
DRIVES = [*LOSSY, "cia402-csv", "cia402-torque"]
FEW = with_rt(["odrive-0.6", "cia402-csv"])


@pytest.fixture(params=long_but(FEW, with_rt(DRIVES)))
def variant(request):
    return request.param


@pytest.fixture
def profile(variant):
    return shipped_profile(variant.removesuffix(RT))


def speeds(sim):
    return [joint.velocity_rad_s for joint in sim.truth().joints.values()]


async def set_off(rig, sim):
    await rig.arm()
    rig.loop.velocity_rad_s = {0: SPEED_RAD_S, 1: SPEED_RAD_S}
    await rig.drive(lambda: min(speeds(sim)) > 0.9 * SPEED_RAD_S, "both wheels turn")


async def back_at_rest(rig, sim):
    await rig.ready()
    await until(lambda: not any(_enabled(sim)), "no wheel is driven")
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 20)
    assert not any(_enabled(sim))


def _enabled(sim):
    return [joint.enabled for joint in sim.truth().joints.values()]


async def test_a_drive_that_lost_its_power_comes_back_disarmed(rig, sim):
    await set_off(rig, sim)
    earlier = len(rig.events)  # on a busy machine a drive may have been back before
    with without_power(sim, 1, 2):
        await until(lambda: rig.states() == {DriveState.UNRESPONSIVE}, "both are unresponsive")
    await back_at_rest(rig, sim)
    back = [event for event in rig.events[earlier:] if event.kind is EventKind.DRIVE_BACK]
    assert {joint for event in back for joint in event.joints} == {"left", "right"}


async def test_an_arming_without_answers_leaves_no_cancellation_behind(rig, sim):
    await rig.ready()
    sim.inject("drop:p=1")
    sim.inject("unheard:p=1")
    with contextlib.suppress(HalError):  # of those drives that confirm it
        await rig.line.arm()
    assert asyncio.current_task().cancelling() == 0


async def test_a_cut_cable_stops_the_drives_by_their_watchdogs_and_they_come_back_disarmed(
    rig, sim
):
    await set_off(rig, sim)
    sim.pull("bus")  # a bus of datagrams falls silent; a Unix socket is closed
    lost = {DriveState.UNRESPONSIVE, DriveState.UNKNOWN}
    await until(lambda: rig.states() <= lost, "both are unresponsive")
    await until(lambda: not any(_enabled(sim)), "their watchdogs have tripped")
    sim.plug("bus")
    await back_at_rest(rig, sim)


async def test_bus_off_ends_the_drive_and_it_comes_back_disarmed(rig, sim):
    await set_off(rig, sim)
    sim.inject("bus-off:for_s=0.7")
    await until(lambda: EventKind.LINE_LOST in rig.kinds())
    await back_at_rest(rig, sim)
    assert rig.line.stats().errors["bus_off"] == 1


@pytest.mark.parametrize("variant", long_but(FEW, with_rt(LOSSY)), indirect=True)
async def test_lost_frames_in_both_directions_are_tolerated(rig, sim):
    sim.inject("drop:p=0.03")
    sim.inject("unheard:p=0.05")
    await set_off(rig, sim)
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 100)
    rig.loop.velocity_rad_s = {}
    await until(lambda: sim.truth().at_rest, "both wheels are at rest")
    assert EventKind.DRIVE_UNRESPONSIVE not in rig.kinds()
    await rig.line.disarm()
    sim.clear_faults_script()
    await back_at_rest(rig, sim)
