# SPDX-License-Identifier: Apache-2.0
"""A disarm of drives whose every reply is damaged or lost: they get it all the same."""

import contextlib

import pytest
from loop_side import until
from tests.contract.harmed.test_harmed_replies import MEDIA, armed_line
from tests.long_cases import long_but

from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import DriveState

HARM = {"damaged": "corrupt:", "lost": "drop:"}
NAMES = ("modbus-rtu rt", "modbus-rtu asyncio", "modbus-tcp", "rtu-over-tcp", "ddsm",
         *(f"{kind} {n}" for kind in ("feetech", "dynamixel") for n in (2, 6, 8)))  # fmt: skip
"""Media with drives that turn and have an enable."""
CASES = {f"{name}: {harm}": (name, harm) for name in NAMES for harm in HARM}
FEW = tuple(f"{name}: damaged" for name in ("feetech 2", "dynamixel 2", "modbus-rtu rt"))


@pytest.mark.parametrize("case", long_but(FEW, CASES))
async def test_a_drive_without_one_good_reply_is_disarmed(case, tmp_path):
    name, harm = CASES[case]
    folder = tmp_path / ("rt" if MEDIA[name].rt else "asyncio")
    folder.mkdir()
    async with armed_line(MEDIA[name], folder) as (rig, control):
        rig.loop.velocity_rad_s = dict.fromkeys(range(MEDIA[name].joints), 1.0)
        await rig.drive(lambda: control.truth().moved_max_m_s > 0, "they turn")
        control.inject(HARM[harm])
        rig.loop.enabled = False
        rig.loop.put()
        with contextlib.suppress(HalError):  # no reply confirms it
            await rig.line.disarm()

        def has_power():
            return any(joint.enabled for joint in control.truth().joints.values())

        await until(lambda: not has_power(), "every drive is without power")
        assert DriveState.ARMED not in rig.states()
