# SPDX-License-Identifier: Apache-2.0
"""[safety.estop] and [safety.watchdog]: pins that stop the robot, and that hold its power."""

from __future__ import annotations

from typing import Literal

from motord.config.sections.section import Section, number


class SafetyPin(Section):
    """A GPIO line of the computer itself: a line behind I2C or SPI would delay the loop."""

    gpio_chip: str
    """Label of the GPIO chip, as pinctrl-rp1, or its device file."""
    gpio_line: str
    """The line's name, or its number on the chip."""


class EstopInput(SafetyPin):
    """A contact of the emergency stop. The loop looks at it in every tick."""

    contact: Literal["normally-closed", "normally-open"] = "normally-closed"
    """Kind of contact. A normally-closed one is closed while all is well: a broken wire stops the
    robot, too."""
    switches_to: Literal["ground", "supply"] = "ground"
    """What the closed contact connects the line to."""
    pull: bool = True
    """Whether the chip pulls the line to the opposite level; false: a resistor outside the chip
    does."""

    @property
    def stop_is_high(self) -> bool:
        """Whether the line is high when the robot has to stop."""
        return (self.contact == "normally-closed") == (self.switches_to == "ground")


class WatchdogOutput(SafetyPin):
    """A pin that changes while the loop, asyncio and the lines with enabled drives work; else it is
    low."""

    every_ticks: int = number("ticks of the loop from one change to the next", 1, 1000, "1", 1)
