# SPDX-License-Identifier: Apache-2.0
"""A steering servo on a PWM pin: the shipped line and profile, and the files of a PWM chip."""

import math

import pytest
from loop_side import running, until
from pwm_rig import Chip, spec_of

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState, JointSpec

MIDDLE_NS, HALF_MS_NS = 1_500_000, 500_000
FULL_RAD = math.tau / 8


@pytest.fixture
def chip(tmp_path):
    return Chip(tmp_path / "pwmchip0")


def servo(chip, **changes):
    joint = JointSpec(
        index=0, name="steering", profile=find_profile("rc-servo"), unit=1,
        pins={"signal": "pwm0"}, **changes,
    )  # fmt: skip
    return spec_of(chip, joints=(joint,))


def pulse_of(rad):
    return MIDDLE_NS + round(HALF_MS_NS * rad / FULL_RAD)


async def test_its_pulse_is_the_angle_that_is_commanded_and_only_while_it_is_armed(chip):
    async with running(servo(chip)) as rig:
        await rig.ready()
        rig.loop.enabled, rig.loop.position_rad = True, {0: 0.3}
        cycles = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles > cycles + 10)
        assert chip.read(0, "duty_cycle") == 0
        await rig.line.arm()
        for rad in (0.3, -0.4, FULL_RAD, 0.0):
            rig.loop.position_rad = {0: rad}
            await until(lambda rad=rad: chip.read(0, "duty_cycle") == pulse_of(rad))
        assert chip.read(0, "period") == 20_000_000
        await rig.line.disarm()
        await until(lambda: chip.read(0, "duty_cycle") == 0)


async def test_without_a_position_it_holds_the_last_one_and_never_leaves_its_range(chip):
    async with running(servo(chip, inverted=True, gear_ratio=2.0)) as rig:
        await rig.ready()
        rig.loop.enabled, rig.loop.position_rad = True, {0: 9.0}
        await rig.line.arm()
        await until(lambda: chip.read(0, "duty_cycle") == MIDDLE_NS - HALF_MS_NS)
        rig.loop.position_rad = {0: -0.1}
        await until(lambda: chip.read(0, "duty_cycle") == pulse_of(0.2))
        rig.loop.position_rad = {}
        cycles = rig.line.stats().cycles
        await until(lambda: rig.line.stats().cycles > cycles + 10)
        assert chip.read(0, "duty_cycle") == pulse_of(0.2)


async def test_a_loop_that_dies_leaves_it_no_pulses(chip):
    async with running(servo(chip)) as rig:
        await rig.ready()
        rig.loop.enabled, rig.loop.position_rad = True, {0: 0.5}
        await rig.line.arm()
        await until(lambda: chip.read(0, "duty_cycle") == pulse_of(0.5))
        rig.loop.running = False
        await until(lambda: chip.read(0, "duty_cycle") == 0)
        await until(lambda: rig.states() != {DriveState.ARMED})


async def test_a_line_that_ends_leaves_no_pulses(chip):
    async with running(servo(chip)) as rig:
        await rig.ready()
        rig.loop.enabled, rig.loop.position_rad = True, {0: 0.5}
        await rig.line.arm()
        await until(lambda: chip.read(0, "duty_cycle") == pulse_of(0.5))
    assert chip.read(0, "duty_cycle") == 0
