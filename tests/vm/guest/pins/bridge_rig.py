# SPDX-License-Identifier: Apache-2.0
"""Lines of motor bridges on the pins of the guest."""

import itertools

from pin_rig import LABEL, LINES

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import JointSpec, LineSpec, PinsSpec


def laid_out(drives):
    """Each bridge's pins: a PWM channel for each that needs one, a GPIO line for each other."""
    channels, lines = (f"pwm{n}" for n in itertools.count()), iter(LINES)
    bridges = {drive: find_profile(drive).bridge for drive in drives}
    return {
        drive: {pin: next(channels if bridge.needs_pwm(pin) else lines) for pin in bridge.levels}
        for drive, bridge in bridges.items()
    }


def places(drive, fault=False):
    return laid_out([drive])[drive] | ({"fault": "!PIN11"} if fault else {})


def spec_of(rig, drive, **changes):
    where = changes.pop("where", None) or places(drive, changes.pop("fault", False))
    joint = JointSpec(index=0, name="left", profile=find_profile(drive), unit=1, pins=where)
    values = {
        "index": 0, "name": "pins", "kind": "pwm", "port": "", "baudrate": 115200,
        "parity": "none", "stop_bits": 1, "cycle_hz": 50.0, "gap_s": None, "engine": "auto",
        "joints": (joint,), "watchdog_s": 0.5, "priority": 0,
        "pins": PinsSpec(pwm_chip=rig.pwm_chip, gpio_chip=LABEL),
    }  # fmt: skip
    return LineSpec(**{**values, **changes})
