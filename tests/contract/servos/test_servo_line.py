# SPDX-License-Identifier: Apache-2.0
"""Bus servos on the line that runs in C, against simulated ones: one cycle for all of them."""

import dataclasses

import pytest
from loop_side import running, until
from sim_bench import simulated, spec_of

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import DriveState

WANTED_RAD_S = 1.0
SERVOS = ["sts3215", "xl430"]


def servo_line(name, folder):
    """Return the line of a servo, without real-time priority."""
    return dataclasses.replace(spec_of(find_profile(name), folder), priority=0)


@pytest.mark.parametrize("name", SERVOS)
async def test_servos_are_armed_follow_their_set_points_and_come_to_rest(name, tmp_path):
    with simulated(find_profile(name), tmp_path) as control:
        async with running(servo_line(name, tmp_path)) as rig:

            def speeds_are(wanted_rad_s):
                measured = [rig.loop.exchange.take_feedback(n) for n in (0, 1)]
                return all(abs(one.velocity_rad_s - wanted_rad_s) < 0.1 for one in measured)

            await rig.arm()
            rig.loop.velocity_rad_s = {0: WANTED_RAD_S, 1: WANTED_RAD_S}
            await rig.drive(lambda: speeds_are(WANTED_RAD_S), "they turn")
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}
            await until(lambda: speeds_are(0.0), "they rest")
            assert 9.0 < await rig.line.read_register("left", "voltage") < 13.0
        assert control is not None
