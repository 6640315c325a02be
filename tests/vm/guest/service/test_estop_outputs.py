# SPDX-License-Identifier: Apache-2.0
"""The emergency stop, from the pin of its contact to the pins of the motors, by kernel drivers."""

import time

import pytest
from pin_rig import LABEL, LINES
from shell import output, wait_until
from stage import granted
from unit import prepared, started
from unit_robots import pwm

from motord.client import Refused

CONTACT = LINES[8]
SAFETY = f"""
[safety.estop]
gpio_chip = "{LABEL}"
gpio_line = "{CONTACT}"
contact = "normally-closed"
switches_to = "ground"
pull = false
"""


def test_an_open_contact_ends_every_motors_pulses_and_then_its_power(capsys):
    name = "estop-pwm"
    with (
        pwm(name, SAFETY) as (sim, robot),
        prepared(name, f"WatchdogSec=90\n{output('motord', 'unit', str(robot))}"),
    ):
        sim.rig.drive(CONTACT, 0)
        with started(name, sim) as unit:
            unit.drive_on(0.4)
            opened_s = time.monotonic()
            sim.rig.drive(CONTACT, 1)
            while not sim.truth().at_rest:
                assert time.monotonic() < opened_s + 60.0, unit.logged()
            pulses_s = time.monotonic() - opened_s
            wait_until(unit.rests_without_power, "the enables", unit.logged)
            power_s = time.monotonic() - opened_s
            unit.wait_for("estop")
            with pytest.raises(Refused):
                unit.robot.reset()
            assert unit.rests_without_power()
            sim.rig.drive(CONTACT, 0)
            granted(unit.robot.reset, "a reset", unit.logged)
            unit.wait_for("idle")
            unit.drive_on(0.4)
    with capsys.disabled():
        print(f"\nestop: no pulses after {pulses_s:.2f} s, no power after {power_s:.2f} s")
