# SPDX-License-Identifier: Apache-2.0
"""A program that turns both wheels of a simulated robot until it is killed: `python
left_running.py VARIANT FOLDER PORT WATCHDOG_S`. It prints a line when the drives are armed."""

from __future__ import annotations

import asyncio
import dataclasses
import sys
from pathlib import Path

from loop_side import running
from sim_bench import GEAR, RT, spec_of
from tests.shipped import shipped_profile

SPEED_RAD_S = 6.0
DUTY = 0.5
FAR_RAD = 15.0
"""A target that no drive reaches before the program is killed, nearer than a joint can get in
PATIENT_S, which is the limit of a first target."""
FAST_RAD_S = 20.0
BAUDRATE, TURNAROUND_S = 115200, 0.002
"""Those of slow drives, too."""


def profile_of(variant):
    """Return the profile of a variant, on a pty, which has no parity."""
    found = shipped_profile(variant.removesuffix(RT))
    if found.protocol != "modbus-rtu":
        return found
    wire = {"baudrate": BAUDRATE, "turnaround_s": TURNAROUND_S, "parity": "none"}
    return dataclasses.replace(found, **wire)


def left_spec(profile, folder):
    """Return the line; joints that take positions have the speed of their targets, and a simulated
    absolute encoder is at the middle of its turn at angle 0."""
    spec = spec_of(profile, folder)
    if not profile.goes_to_positions:
        return spec
    zero_count = profile.counts_per_turn // 2 if profile.absolute else 0
    own = {"zero_count": zero_count, "position_velocity_rad_s": FAST_RAD_S}
    joints = tuple(dataclasses.replace(joint, **own) for joint in spec.joints)
    return dataclasses.replace(spec, joints=joints)


def speed_of(profile):
    """Return the wheels' speed; a slow drive gets less than it can reach."""
    setpoint = profile.channels[1].velocity_setpoint
    if setpoint is None:
        return SPEED_RAD_S
    return min(SPEED_RAD_S, 0.75 * profile.registers[setpoint].si_limits[1] / GEAR)


async def drive(profile, folder, port, watchdog_s):
    spec = left_spec(profile, folder)
    spec = dataclasses.replace(spec, port=port, watchdog_s=watchdog_s)
    async with running(spec) as rig:
        speed_rad_s = speed_of(profile)
        rig.loop.velocity_rad_s = {0: speed_rad_s, 1: speed_rad_s}
        rig.loop.duty = {0: DUTY, 1: DUTY}
        await rig.arm()
        if profile.goes_to_positions:
            rig.loop.position_rad = {0: FAR_RAD, 1: FAR_RAD}
        rig.loop.enabled = True
        print("armed", flush=True)
        while True:
            await rig.drive(lambda: False, "")


if __name__ == "__main__":
    variant, path, port, seconds = sys.argv[1:]
    asyncio.run(drive(profile_of(variant), Path(path), port, float(seconds)))
