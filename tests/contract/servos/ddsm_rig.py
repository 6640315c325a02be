# SPDX-License-Identifier: Apache-2.0
"""Frames of a DDSM115 hub motor, written and read by hand."""

import dataclasses

from motord.config.drives.load import find_profile
from motord_hal.drives.profile import Channel, Register, RegisterType, Step

SET, QUERY, MODE, SPEED = 0x64, 0x74, 0xA0, 2

COUNTS = 32768


def register(name, command, byte, access, kind="i16", unit="", **more):
    return Register(
        name=name,
        address=command << 8 | byte,
        type=RegisterType(kind),
        scale=more.pop("scale", 1.0),
        unit=unit,
        access=access,
        minimum=more.pop("minimum", None),
        maximum=more.pop("maximum", None),
        source="the maker's table",
        **more,
    )


def hub_motor():
    """Return the motor's profile with 16-bit registers; the mode is its register's second byte."""
    registers = [
        register("speed_wanted", SET, 2, "w", unit="rpm", minimum=-330.0, maximum=330.0),
        register("current", SET, 2, "r", unit="a", scale=8 / 32767),
        register("speed", SET, 4, "r", unit="rpm"),
        register("position", SET, 6, "r", "u16", unit="count"),
        register("supply", QUERY, 4, "r", "u16", unit="v"),
        register("mode", MODE, 8, "w", "u16"),
    ]
    return dataclasses.replace(
        find_profile("duty-register"),
        name="hub-motor",
        protocol="ddsm",
        turnaround_s=0.002,
        counts_per_turn=COUNTS,
        counter_bits=15,
        registers={one.name: one for one in registers},
        channels={
            1: Channel(
                velocity_setpoint="speed_wanted",
                position="position",
                velocity="speed",
                current="current",
            )
        },
        configure=(),
        arm=(Step(register="mode", value=SPEED),),
        disarm=(Step(register="mode", value=1),),
        quick_stop=(Step(register="mode", value=1),),
        clear_fault=(),
        enabled=None,
        watchdog=None,
        faults=(),
        bus_voltage="supply",
    )
