# SPDX-License-Identifier: Apache-2.0
"""A line of PWM pins in a folder of plain files."""

import asyncio
import contextlib

from loop_side import GENEROUS_S

from motord.config.drives.load import find_profile
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import (
    DriveState,
    JointSpec,
    LineSpec,
    PinsSpec,
)

PERIOD_NS = 50_000


class Chip:
    """Files like those of exported channels; a shorter number leaves the tail of a longer one."""

    def __init__(self, folder):
        self.folder = folder
        for number in range(4):
            channel = folder / f"pwm{number}"
            channel.mkdir(parents=True)
            for name, value in (("period", "0"), ("duty_cycle", "0"), ("enable", "0")):
                (channel / name).write_text(f"{value}\n")
            (channel / "polarity").write_text("normal\n")

    def read(self, number, name):
        return int((self.folder / f"pwm{number}/{name}").read_text().splitlines()[0])

    def duties(self):
        return [self.read(number, "duty_cycle") for number in range(4)]


def spec_of(chip, drive="bts7960", **changes):
    profile = find_profile(drive)
    joints = (
        JointSpec(index=0, name="left", profile=profile, unit=1,
                  pins={"rpwm": "pwm0", "lpwm": "pwm1"}),
        JointSpec(index=1, name="right", profile=profile, unit=2, inverted=True,
                  pins={"rpwm": "pwm2", "lpwm": "!pwm3"}),
    )  # fmt: skip
    values = {
        "index": 0, "name": "pins", "kind": "pwm", "port": "", "baudrate": 115200,
        "parity": "none", "stop_bits": 1, "cycle_hz": 200.0, "gap_s": None, "engine": "auto",
        "joints": joints, "watchdog_s": 0.5, "priority": 0,
        "pins": PinsSpec(pwm_chip=str(chip.folder)),
    }  # fmt: skip
    return LineSpec(**{**values, **changes})


async def armed(rig):
    """Arm the line; repeat it where a busy machine let the set-points get too old."""
    async with asyncio.timeout(GENEROUS_S):
        while rig.states() != {DriveState.ARMED}:
            await rig.ready()
            with contextlib.suppress(HalError):
                await rig.line.arm()
            await asyncio.sleep(0.01)
