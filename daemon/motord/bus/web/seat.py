# SPDX-License-Identifier: Apache-2.0
"""Decides which page drives: one at a time, as long as its pad is held. All pages share the lease
of their input, and the lifetime of that lease in the daemon guarantees that the robot stops. The
rules here only keep a command from counting again after a pause."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

from motord.bus.commands.delay import Delays
from motord.bus.commands.gate import CommandGate, NotTaken
from motord.bus.commands.senders import Sender
from motord.bus.web.frames import DriveFrame

SEEN_MAX_S = 1.0
"""Greatest age of the state that a page shows: a driver with an older one cannot know where the
robot is."""
SEEN_AHEAD_S = 0.1
"""Greatest time by which that state may be ahead: a later one is from before this computer was
started."""
PAUSED = "no command for {:g} s: release the pad and press it again"
OLD_VIEW = "the page shows a state of {:.1f} s ago: the connection is too slow to drive"
TAKEN = "{} is driving"
RESERVED = "{} is running on another page or here: the pad does not drive meanwhile"


@dataclass(slots=True, eq=False)
class Driver:
    """A page that may drive."""

    name: str
    press: int = 0
    """Number of the newest hold of its pad."""
    over: int = 0
    """Number of the newest hold that is over; all earlier ones are over, too."""
    last_s: float = -math.inf
    """Time at which its newest command was passed on; -inf: it does not drive."""
    delays: Delays = field(default_factory=Delays)


class Seat:
    """Chooses the page that drives, for one input."""

    def __init__(self, gate: CommandGate, lease_s: float) -> None:
        self._gate = gate
        self._lease_s = lease_s
        self._driver: Driver | None = None
        self.reserved_for: str | None = None
        """Name of the procedure that moves the robot; no page drives meanwhile. None: no procedure
        runs."""

    @property
    def driver(self) -> str | None:
        """Name of the page that drives now; None: no page drives."""
        if self._driver is None or time.monotonic() - self._driver.last_s > self._lease_s:
            return None
        return self._driver.name

    def drive(self, driver: Driver, command: DriveFrame) -> None:
        """Pass a command on. Raises NotTaken."""
        now_s = time.monotonic()
        waited_s = driver.delays.waited_s("page", round(command.sent_ms * 1e6))
        if self.reserved_for is not None:
            self.release(driver, command.press)
            raise NotTaken(RESERVED.format(self.reserved_for))
        if command.press <= driver.over:
            raise NotTaken(PAUSED.format(self._lease_s))
        if command.press > driver.press:
            driver.press, driver.last_s = command.press, now_s
        if max(now_s - driver.last_s, waited_s) > self._lease_s:
            self.release(driver, command.press)
            raise NotTaken(PAUSED.format(self._lease_s))
        if self._driver is not driver and self.driver is not None:
            driver.over = command.press
            raise NotTaken(TAKEN.format(self.driver))
        if not -SEEN_AHEAD_S <= now_s - command.seen_s <= SEEN_MAX_S:
            self.release(driver, command.press)
            raise NotTaken(OLD_VIEW.format(now_s - command.seen_s))
        self._driver, driver.last_s = driver, now_s
        linear = {"x": command.linear_m_s, "y": command.lateral_m_s, "z": 0.0}
        twist = {"linear": linear, "angular": {"z": command.angular_rad_s}}
        self._gate.drive(twist, waited_s, Sender(driver.name, driver))

    def release(self, driver: Driver, press: int) -> None:
        """End a hold of the pad, also for its commands that still arrive."""
        driver.over = max(driver.over, press)
        if self._driver is driver:
            self._driver, driver.last_s = None, -math.inf
            self._gate.rest(Sender(driver.name, driver))

    def leave(self, driver: Driver) -> None:
        """End the hold of a page that is gone."""
        self.release(driver, driver.press)
