# SPDX-License-Identifier: Apache-2.0
"""A GPIO chip of the kernel's own simulator.

Source: kernel, Documentation/admin-guide/gpio/gpio-sim.rst.
"""

import contextlib
from pathlib import Path

from shell import wait_until

CONFIG = Path("/sys/kernel/config/gpio-sim")


@contextlib.contextmanager
def gpio_chip(label, *names, folder=None):
    """A chip with these lines; yields a function: a line's name → its level. Chips with the same
    label need different folders."""
    chip = CONFIG / (folder or label)
    bank = chip / "bank0"
    bank.mkdir(parents=True)
    (bank / "num_lines").write_text(str(len(names)))
    (bank / "label").write_text(label)
    for offset, name in enumerate(names):
        (bank / f"line{offset}").mkdir()
        (bank / f"line{offset}/name").write_text(name)
    (chip / "live").write_text("1")
    device = (chip / "dev_name").read_text().strip()
    number = (bank / "chip_name").read_text().strip()
    lines = Path("/sys/devices/platform", device, number)
    wait_until(Path("/dev", number).exists, "the chip's device file")

    def level_of(name):
        return int((lines / f"sim_gpio{names.index(name)}/value").read_text())

    try:
        yield level_of
    finally:
        (chip / "live").write_text("0")
        for folder in (*(bank / f"line{n}" for n in range(len(names))), bank, chip):
            folder.rmdir()
