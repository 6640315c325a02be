# SPDX-License-Identifier: Apache-2.0
"""Hub motors that are no Modbus drives, on the line that runs in C."""

import dataclasses

from ddsm_rig import hub_motor
from loop_side import running, until
from sim_bench import simulated, spec_of

from motord_hal.fieldbus.ports import DriveState

WANTED_RAD_S = 3.0


async def test_hub_motors_are_armed_follow_their_set_points_and_come_to_rest(tmp_path):
    profile = hub_motor()
    with simulated(profile, tmp_path):
        spec = dataclasses.replace(spec_of(profile, tmp_path), kind="ddsm", engine="rt", priority=0)
        async with running(spec) as rig:

            def speeds_are(want_rad_s):
                measured = [rig.loop.exchange.take_feedback(n).velocity_rad_s for n in (0, 1)]
                return all(abs(speed - want_rad_s) < 0.3 for speed in measured)

            await rig.arm()
            rig.loop.enabled = True
            rig.loop.velocity_rad_s = {0: WANTED_RAD_S, 1: WANTED_RAD_S}
            await until(lambda: speeds_are(WANTED_RAD_S), "they turn")
            await rig.line.disarm()
            assert rig.states() == {DriveState.READY}
            await until(lambda: speeds_are(0.0), "they rest")
            assert await rig.line.read_register("left", "supply") > 0
