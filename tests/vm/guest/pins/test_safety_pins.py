# SPDX-License-Identifier: Apache-2.0
"""The input of the emergency stop and the output of the watchdog on GPIO lines of the kernel."""

import contextlib
import os

import pytest
from gpio_chip import gpio_chip
from gpiod.line import Bias
from pin_rig import wait_until
from safety_rig import CONTACT, LABEL, PUMP, chip, looped, reset

from motord_hal.base.errors import PortError
from motord_hal.gpio.lines import Wanted, request_edges

pytestmark = pytest.mark.timeout(300)


@pytest.mark.smoke
def test_only_an_open_contact_is_an_emergency_stop():
    with chip() as lines:
        lines.drive(CONTACT, 0)
        with looped() as loop:
            wait_until(lambda: loop.status().ticks > 20, "ticks")
            assert loop.read_state().faults == ()
            assert loop.status().estop_input == "clear"
            lines.drive(CONTACT, 1)
            wait_until(lambda: loop.read_state().faults == ("estop",), "the emergency stop")
            assert loop.status().estop_input == "active"


def test_a_broken_wire_stops_because_the_chip_pulls_the_line_up():
    with chip() as lines, looped(pull=Bias.PULL_UP) as loop:
        assert lines.level(CONTACT) == 1.0  # from the requested bias: nothing drives the line
        assert loop.read_state().faults == ("estop",)


def test_an_emergency_stop_is_reset_only_when_the_contact_is_closed():
    with chip() as lines, looped() as loop:
        lines.drive(CONTACT, 1)
        wait_until(lambda: loop.read_state().faults == ("estop",), "the emergency stop")
        reset(loop, 1)
        assert loop.read_state().faults == ("estop",)
        lines.drive(CONTACT, 0)
        wait_until(lambda: loop.status().estop_input == "clear", "the contact")
        assert loop.read_state().faults == ("estop",)
        reset(loop, 2)
        wait_until(lambda: loop.read_state().faults == (), "the reset")


def test_a_contact_that_opens_between_two_ticks_is_an_emergency_stop():
    with chip() as lines:
        lines.drive(CONTACT, 0)
        with looped(rate_hz=10.0) as loop:
            assert loop.read_state().faults == ()
            lines.drive(CONTACT, 1)
            lines.drive(CONTACT, 0)
            wait_until(lambda: loop.read_state().faults == ("estop",), "the emergency stop")


def test_a_removed_chip_is_an_emergency_stop_that_no_reset_clears():
    with chip() as lines:
        lines.drive(CONTACT, 0)
        with looped() as loop:
            wait_until(lambda: loop.status().ticks > 20, "ticks")
            assert loop.read_state().faults == ()
            lines.remove()
            wait_until(lambda: loop.read_state().faults == ("estop",), "the emergency stop")
            assert loop.status().estop_input == "lost"
            reset(loop, 1)
            assert loop.read_state().faults == ("estop",)


@pytest.mark.smoke
def test_the_watchdog_pin_toggles_and_is_low_when_asyncio_hangs():
    with chip() as lines, looped() as loop:
        levels = set()

        def both():
            loop.beat()
            levels.add(lines.level(PUMP))
            return levels == {0.0, 1.0}

        wait_until(both, "both levels")
        assert loop.status().watchdog_errno == 0
        wait_until(lambda: not loop.status().watchdog, "the watchdog's end")
        seen = loop.status().watchdog_edges
        wait_until(lambda: lines.level(PUMP) == 0.0, "low")
        assert loop.status().watchdog_edges == seen


def test_the_watchdog_pin_is_low_when_the_loop_has_ended():
    with chip() as lines:
        with looped() as loop:
            loop.beat()
            wait_until(lambda: loop.status().watchdog_edges > 3, "edges")
        assert lines.level(PUMP) == 0.0


def test_a_pull_is_refused_on_a_chip_with_a_driver_that_ignores_it():
    wanted = Wanted(line=CONTACT, purpose="safety.estop")
    with gpio_chip("tegra234-gpio", CONTACT):
        with pytest.raises(PortError, match=r'safety.estop: the chip "tegra234-gpio" has no pulls'):
            request_edges("tegra234-gpio", wanted, "motord", Bias.PULL_UP, rising=True)
        os.close(request_edges("tegra234-gpio", wanted, "motord", Bias.AS_IS, rising=True))


def test_an_ambiguous_chip_label_or_line_name_is_refused():
    wanted = Wanted(line="A", purpose="safety.estop")
    twice = gpio_chip("motord-twice", "A", "B", "A")
    with twice, pytest.raises(PortError, match=r"safety\.estop: lines 0, 2 of this chip have the"):
        request_edges("motord-twice", wanted, "motord", Bias.AS_IS, rising=True)
    one, other = gpio_chip("motord-twice", "A"), gpio_chip("motord-twice", "A", folder="other")
    with one, other, pytest.raises(PortError, match=r'2 GPIO chips have the label "motord-twic'):
        request_edges("motord-twice", wanted, "motord", Bias.AS_IS, rising=True)


def test_a_line_in_use_is_named_with_its_owner():
    wanted = Wanted(line=CONTACT, purpose="safety.estop")
    with chip(), contextlib.ExitStack() as unless_ended:
        first = request_edges(LABEL, wanted, "somebody", Bias.PULL_UP, rising=True)
        unless_ended.callback(os.close, first)
        with pytest.raises(PortError, match=r'safety.estop: line 0 .* is in use by "somebody"'):
            request_edges(LABEL, wanted, "motord", Bias.PULL_UP, rising=True)
