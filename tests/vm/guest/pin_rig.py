# SPDX-License-Identifier: Apache-2.0
"""Pins of the kernel's simulated GPIO chip and of its PWM class, as the kernel sees them.

Source: kernel, Documentation/admin-guide/gpio/gpio-sim.rst and Documentation/driver-api/pwm.rst.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import time
from pathlib import Path

CONFIG = Path("/sys/kernel/config/gpio-sim")
PWM = Path("/sys/class/pwm")
LABEL = "motord-pins"
TURN = Path("/run/pins.turn")
LINES = tuple(f"PIN{n}" for n in range(12))
DEADLINE_S = 60.0


def wait_until(condition, what):
    """Calls `condition` until it is true. The deadline allows for a slow guest."""
    end_s = time.monotonic() + DEADLINE_S
    while not (found := condition()):
        assert time.monotonic() < end_s, f"{what}: never"
        time.sleep(0.02)
    return found


@dataclasses.dataclass(frozen=True)
class Pins:
    """The files in which levels are read and inputs are driven."""

    lines: Path
    chip: Path
    """Of the PWM class."""

    @property
    def pwm_chip(self):
        return Path(self.chip / "device").resolve().name

    def level(self, where):
        """0 to 1: of a GPIO line's output, or the part of the period of an enabled channel."""
        if where.startswith("pwm"):
            folder = self.chip / where
            period_ns = int((folder / "period").read_text())
            on = (folder / "enable").read_text().strip() == "1"
            return on * int((folder / "duty_cycle").read_text()) / period_ns
        number = LINES.index(where)
        return float((self.lines / f"sim_gpio{number}/value").read_text())

    def drive(self, where, level):
        """Drives an input from outside."""
        pull = self.lines / f"sim_gpio{LINES.index(where)}/pull"
        pull.write_text("pull-up" if level else "pull-down")


@contextlib.contextmanager
def pins():
    """A GPIO chip with LINES, and the first PWM chip of the machine: for one user at a time."""
    with TURN.open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        with _pins() as found:
            yield found


@contextlib.contextmanager
def _pins():
    chip = CONFIG / LABEL
    bank = chip / "bank0"
    bank.mkdir(parents=True)
    (bank / "num_lines").write_text(str(len(LINES)))
    (bank / "label").write_text(LABEL)
    for offset, name in enumerate(LINES):
        (bank / f"line{offset}").mkdir()
        (bank / f"line{offset}/name").write_text(name)
    (chip / "live").write_text("1")
    device, number = (chip / "dev_name").read_text().strip(), (bank / "chip_name").read_text()
    wait_until(Path("/dev", number.strip()).exists, "the chip's device file")
    try:
        yield Pins(Path("/sys/devices/platform", device, number.strip()), min(PWM.iterdir()))
    finally:
        (chip / "live").write_text("0")
        for folder in (*(bank / f"line{n}" for n in range(len(LINES))), bank, chip):
            folder.rmdir()
