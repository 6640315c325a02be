# SPDX-License-Identifier: Apache-2.0
"""Every shipped drive on CAN that goes to positions, against simulated ones, whose true joint
angles are known."""

import dataclasses
import math

import pytest
from loop_side import running, until
from sim_bench import GEAR, RT, folder_of, spec_of, without_power
from tests.long_cases import long_but
from tests.shipped import NAMES, shipped_profile

from motord_hal.fieldbus.ports import DriveState, EventKind

PROFILES = [
    name
    for name in NAMES
    if shipped_profile(name).can is not None and shipped_profile(name).goes_to_positions
]
FAST_RAD_S, LIMITED_RAD_S = 20.0, 1.0
NEAR_RAD = 0.02
FAR_RAD = 15.0
"""Far target, nearer than a joint can get in PATIENT_S: the limit of a first target."""


@pytest.fixture(params=long_but(PROFILES[:1], PROFILES))
def profile(request):
    return shipped_profile(request.param)


@pytest.fixture
def folder(tmp_path):
    return folder_of(RT, tmp_path)


def line_of(profile, folder, speed_rad_s=FAST_RAD_S):
    """Return the line; a simulated absolute encoder is at the middle of its turn at angle 0."""
    spec = spec_of(profile, folder)
    zero_count = profile.counts_per_turn // 2 if profile.absolute else 0
    own = {"zero_count": zero_count, "position_velocity_rad_s": speed_rad_s}
    joints = tuple(dataclasses.replace(joint, **own) for joint in spec.joints)
    return dataclasses.replace(spec, joints=joints)


@pytest.fixture
async def rig(profile, sim, folder):
    async with running(line_of(profile, folder)) as rig:
        yield rig


def angles_rad(sim):
    return [joint.position_rad for joint in sim.truth().joints.values()]


def powered(sim):
    return [joint.enabled for joint in sim.truth().joints.values()]


def are_at(sim, *wanted_rad):
    return angles_rad(sim) == pytest.approx(list(wanted_rad), abs=NEAR_RAD)


async def some_cycles(rig):
    cycles = rig.line.stats().cycles
    await until(lambda: rig.line.stats().cycles > cycles + 20, "it could have moved")


async def wait_for_motion(rig, sim):
    """Arm both joints, command them far away, and wait until they move."""
    await rig.arm()
    rig.loop.position_rad = {0: FAR_RAD, 1: FAR_RAD}
    await rig.drive(lambda: min(angles_rad(sim)) > 0.5, "both move")


async def stopped(sim):
    await until(lambda: not any(powered(sim)) and sim.truth().at_rest, "they rest, without power")
    assert max(angles_rad(sim)) < FAR_RAD - 1.0, "not where they were going to"


async def test_joints_go_to_their_targets_and_stay_there_without_a_target(rig, sim):
    await rig.arm()
    await some_cycles(rig)
    assert are_at(sim, 0.0, 0.0), "arming moves nothing"
    rig.loop.position_rad = {0: 1.5, 1: -0.7}
    await rig.drive(lambda: are_at(sim, 1.5, -0.7), "they are there")
    rig.loop.position_rad = {0: math.nan}
    await some_cycles(rig)
    assert are_at(sim, 1.5, -0.7)
    await rig.line.disarm()
    assert rig.states() == {DriveState.READY}


async def test_the_reported_angle_is_the_commanded_one(rig, sim, profile):
    await rig.arm()
    rig.loop.position_rad = {0: 0.8, 1: 0.8}
    await rig.drive(lambda: are_at(sim, 0.8, 0.8) and sim.truth().at_rest, "they are there")
    turns, half = 0.8 * GEAR / math.tau, 1 << (profile.counter_bits - 1)
    for joint in rig.line.spec.joints:
        sign = -1.0 if joint.inverted else 1.0
        wanted = joint.zero_count + sign * turns * profile.counts_per_turn
        near = 0.01 * profile.counts_per_turn

        def is_reported(joint=joint, wanted=wanted, near=near):
            count = rig.loop.exchange.take_feedback(joint.index).count
            return abs((count + half) % (2 * half) - half - wanted) < near

        await rig.drive(is_reported, "its place is reported")


async def test_a_joint_whose_old_target_is_far_away_stays_where_it_is_when_it_is_armed(rig, sim):
    await wait_for_motion(rig, sim)
    await rig.line.disarm()
    rig.loop.enabled, rig.loop.position_rad = False, {}
    await stopped(sim)
    before = angles_rad(sim)
    await rig.arm()
    await some_cycles(rig)
    assert are_at(sim, *before)


async def test_a_joint_whose_first_target_is_far_from_its_position_loses_its_power(
    profile, sim, folder
):
    async with running(line_of(profile, folder, LIMITED_RAD_S)) as rig:
        await rig.arm()
        rig.loop.position_rad = {0: 1.5, 1: 0.0}  # as far off as with a wrong zero_count
        rig.loop.enabled = True
        await until(lambda: rig.line.drive_states["left"] is DriveState.READY, "no power")
        await until(lambda: any("check zero_count" in one.text for one in rig.events))
        await until(lambda: sim.truth().at_rest, "they rest")
        assert are_at(sim, 0.0, 0.0)


async def test_old_set_points_stop_the_joints_while_they_move_and_take_their_power(rig, sim):
    await wait_for_motion(rig, sim)
    rig.loop.running = False
    await until(lambda: rig.states() == {DriveState.READY}, "the line has stopped them")
    await stopped(sim)


async def test_a_cut_cable_stops_the_joints_by_their_watchdogs_and_they_come_back_disarmed(
    rig, sim
):
    await wait_for_motion(rig, sim)
    sim.pull("bus")
    await stopped(sim)
    before = angles_rad(sim)
    sim.plug("bus")
    await rig.ready()
    await some_cycles(rig)
    assert not any(powered(sim))
    assert are_at(sim, *before)


async def test_a_joint_that_lost_its_power_comes_back_disarmed_and_goes_nowhere(rig, sim, profile):
    await wait_for_motion(rig, sim)
    with without_power(sim, 1):
        await until(lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds(), "it is unresponsive")
        await until(lambda: sim.truth().joints["left"].velocity_rad_s == 0.0, "it rests")
        before_rad = angles_rad(sim)[0]
    await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "it is back")
    await some_cycles(rig)
    assert rig.line.drive_states["left"] is DriveState.READY
    assert angles_rad(sim)[0] == pytest.approx(before_rad, abs=NEAR_RAD)
    if profile.homed is not None:
        await until(lambda: rig.loop.exchange.take_feedback(0).referenced == 0, "no reference")


async def test_lost_frames_move_no_joint_to_another_position(rig, sim):
    await rig.arm()
    sim.inject("drop:p=0.01")  # few enough that a drive which a busy machine lost is set up again
    sim.inject("unheard:p=0.02")
    rig.loop.position_rad = {0: 1.0, 1: -1.0}
    await rig.drive(lambda: are_at(sim, 1.0, -1.0), "they are there")
    sim.clear_faults_script()
    await rig.line.disarm()
    await until(lambda: not any(powered(sim)), "they have no power")
