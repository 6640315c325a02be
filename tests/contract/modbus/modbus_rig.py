# SPDX-License-Identifier: Apache-2.0
"""A Modbus line of two-channel servo drives that a test scripts register by register."""

import math

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import (
    JointSpec,
    LineSpec,
)

RPM = 2 * math.pi / 60

CONTROL, MODE, TARGET_1, TARGET_2, WATCHDOG = 0x200E, 0x200D, 0x2088, 0x2089, 0x2000

FAULT_1, POSITION_1, VELOCITY_1, VELOCITY_2 = 0x20A5, 0x20A7, 0x20AB, 0x20AC

ENABLE, OFF, QUICK_STOP, CLEAR = 8, 7, 5, 6

ENGINES = ["asyncio", "rt"]


def registers_of(name):
    profile = find_profile(name)
    words = {}
    for register in profile.registers.values():
        words.update(dict.fromkeys(range(register.address, register.address + 1), register.default))
        words.update(
            dict.fromkeys(range(register.address + 1, register.address + register.type.words), 0)
        )
    return words


def hub_servo(unit=1, first=0):
    profile = find_profile("zlac8015d")
    return (
        JointSpec(index=first, name=f"left{unit}", profile=profile, unit=unit, channel=1),
        JointSpec(
            index=first + 1, name=f"right{unit}", profile=profile, unit=unit, channel=2,
            inverted=True, gear_ratio=2.0,
        ),
    )  # fmt: skip


def spec_of(peer, joints, **changes):
    values = {
        "index": 0, "name": "rs485", "kind": peer.kind, "port": str(peer.path),
        "baudrate": 115200, "parity": "none", "stop_bits": 1, "cycle_hz": 100.0, "gap_s": None,
        "engine": peer.engine, "joints": tuple(joints), "watchdog_s": 0.5, "priority": 0,
    }  # fmt: skip
    return LineSpec(**{**values, **changes})


def single_writes(peer, mark):
    """Return address and value of each single-register write after `mark`, in order."""
    after = [received.request for received in peer.received[mark:]]
    return [(one.address, one.values[0]) for one in after if len(one.values) == 1]


def mute(peer):
    """From now on drop each reply; the drive still receives and follows requests."""

    def swallow(request, honest):
        peer.tricks.append(swallow)
        return []

    peer.tricks.append(swallow)
