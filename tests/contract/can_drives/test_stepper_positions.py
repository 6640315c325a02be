# SPDX-License-Identifier: Apache-2.0
"""Closed-loop steppers on Modbus that go to positions, against simulated ones."""

import dataclasses
import math

import pytest
from loop_side import running, until
from sim_bench import GEAR, simulated, spec_of, without_power

from motord.config.drives.load import find_profile
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, EventKind
from motord_hal.realtime.exchange import Exchange

PROFILE = find_profile("cs2rs-position")
COUNTS_PER_RAD = 10000 * GEAR / math.tau
NEAR_RAD = 0.02


def line_of(folder):
    spec = spec_of(PROFILE, folder)
    joints = tuple(
        dataclasses.replace(joint, position_velocity_rad_s=20.0) for joint in spec.joints
    )
    return dataclasses.replace(spec, joints=joints, engine="rt", cycle_hz=30.0)


def angles_rad(control):
    return [joint.position_rad for joint in control.truth().joints.values()]


def powered(control):
    return [joint.enabled for joint in control.truth().joints.values()]


def are_at(control, *wanted_rad):
    return angles_rad(control) == pytest.approx(list(wanted_rad), abs=NEAR_RAD)


async def some_cycles(rig):
    cycles = rig.line.stats().cycles
    await rig.drive(lambda: rig.line.stats().cycles > cycles + 20, "it could have moved")


async def test_steppers_go_to_their_targets_and_stay_there_without_a_target(tmp_path):
    with simulated(PROFILE, tmp_path) as control:
        async with running(line_of(tmp_path)) as rig:
            await rig.arm()
            await some_cycles(rig)
            assert are_at(control, 0.0, 0.0), "arming moves nothing"
            rig.loop.position_rad = {0: 3.0, 1: -2.0}
            await rig.drive(lambda: are_at(control, 3.0, -2.0), "they are there")
            there = pytest.approx(3.0 * COUNTS_PER_RAD, abs=100)
            await rig.drive(lambda: rig.loop.exchange.take_feedback(0).count == there, "reported")
            rig.loop.position_rad = {0: math.nan}
            await some_cycles(rig)
            assert are_at(control, 3.0, -2.0)
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}


async def test_a_stepper_whose_old_target_is_far_away_stays_where_it_is_when_it_is_armed(tmp_path):
    with simulated(PROFILE, tmp_path) as control:
        async with running(line_of(tmp_path)) as rig:
            await rig.arm()
            rig.loop.position_rad = {0: 0.0, 1: 0.0}  # the first target is where they are
            await some_cycles(rig)
            rig.loop.position_rad = {0: 30.0, 1: 30.0}
            await rig.drive(lambda: angles_rad(control)[0] > 1.0, "they are moving")
            await rig.line.disarm()
            rig.loop.enabled, rig.loop.position_rad = False, {}
            await until(lambda: control.truth().at_rest, "they rest")
            before = angles_rad(control)
            await rig.arm()
            await some_cycles(rig)
            assert are_at(control, *before)


async def test_old_set_points_stop_a_stepper_and_take_its_power(tmp_path):
    with simulated(PROFILE, tmp_path) as control:
        async with running(line_of(tmp_path)) as rig:
            await rig.arm()
            rig.loop.position_rad = {0: 0.0, 1: 0.0}  # the first target is where they are
            await some_cycles(rig)
            rig.loop.position_rad = {0: 30.0, 1: 30.0}
            await rig.drive(lambda: angles_rad(control)[0] > 1.0, "they are moving")
            rig.loop.running = False
            await until(lambda: rig.states() == {DriveState.READY}, "the line has stopped them")
            await until(lambda: control.truth().at_rest, "they rest")
            assert angles_rad(control)[0] < 29.0, "not where they were going to"
            await until(lambda: not any(powered(control)), "they have no power")


@pytest.mark.parametrize("kind", ["modbus-rtu", "modbus-tcp", "rtu-over-tcp"])
def test_a_line_in_asyncio_refuses_positions(tmp_path, kind):
    engine = "asyncio" if kind == "modbus-rtu" else "auto"
    spec = dataclasses.replace(line_of(tmp_path), engine=engine, kind=kind)
    with pytest.raises(ProfileError, match="left: positions are carried by the engine rt alone"):
        open_line(spec, Exchange.private(), print)


async def test_a_stepper_that_lost_its_power_has_no_reference_and_gets_no_target(tmp_path):
    with simulated(PROFILE, tmp_path) as control:
        async with running(line_of(tmp_path)) as rig:
            await rig.arm()
            await until(lambda: rig.loop.exchange.take_feedback(0).referenced == 1, "its reference")
            with without_power(control, 1):
                await until(
                    lambda: EventKind.DRIVE_UNRESPONSIVE in rig.kinds(), "it is unresponsive"
                )
            rig.loop.position_rad = {0: 3.0}
            await until(lambda: EventKind.DRIVE_BACK in rig.kinds(), "it is back")
            await until(lambda: rig.loop.exchange.take_feedback(0).referenced == 0, "no reference")
            assert rig.line.drive_states["left"] is DriveState.READY
            cycles = rig.line.stats().cycles
            await until(lambda: rig.line.stats().cycles > cycles + 20, "it could have moved")
            assert angles_rad(control)[0] == pytest.approx(0.0, abs=NEAR_RAD)
