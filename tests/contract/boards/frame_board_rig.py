# SPDX-License-Identifier: Apache-2.0
"""A line of boards with binary frames, and a board that a test scripts."""

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import (
    JointSpec,
    LineSpec,
)


def joints_of(drive="mcu-velocity"):
    profile = find_profile(drive)
    return (
        JointSpec(index=0, name="left", profile=profile, unit=1, channel=1),
        JointSpec(index=1, name="right", profile=profile, unit=1, channel=2, inverted=True,
                  gear_ratio=2.0),
    )  # fmt: skip


def spec_of(peer, joints=None, **changes):
    values = {
        "index": 0, "name": "board", "kind": "mcu", "port": str(peer.link),
        "baudrate": 115200, "parity": "none", "stop_bits": 1, "cycle_hz": 100.0, "gap_s": None,
        "engine": "auto", "joints": joints or joints_of(), "watchdog_s": 0.2, "priority": 0,
    }  # fmt: skip
    return LineSpec(**{**values, **changes})
