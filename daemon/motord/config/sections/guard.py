# SPDX-License-Identifier: Apache-2.0
"""[safety.estop] and [safety.watchdog]: pins that stop the robot, and that hold its power."""

from __future__ import annotations

from typing import Literal

from motord.config.sections.section import Section, number


class SafetyPin(Section):
    """A GPIO line of the computer itself: one behind I2C or SPI would hold the loop up."""

    gpio_chip: str
    """Label of the GPIO chip, as pinctrl-rp1, or its device file."""
    gpio_line: str
    """The line's name, or its number on the chip."""


class EstopInput(SafetyPin):
    """A contact of the emergency stop. The loop looks at it in every tick."""

    contact: Literal["normally-closed", "normally-open"] = "normally-closed"
    """Closed while all is well: then a broken wire stops the robot too."""
    switches_to: Literal["ground", "supply"] = "ground"
    """What the closed contact connects the line with."""
    pull: bool = True
    """The chip pulls the line to the opposite level; false: a resistor outside does."""

    @property
    def stop_is_high(self) -> bool:
        """The level of the line that means stop."""
        return (self.contact == "normally-closed") == (self.switches_to == "ground")


class WatchdogOutput(SafetyPin):
    """Changes while the loop, asyncio and the lines with enabled drives live; low otherwise."""

    every_ticks: int = number("ticks of the loop from one change to the next", 1, 1000, "1", 1)
