# SPDX-License-Identifier: Apache-2.0
"""Steps that give a pin of this machine the function that a robot file needs, and the present user
of a pin.

Sources: Raspberry Pi firmware, overlays/README (pwm, pwm-2chan: pins and functions; func counts as
the BCM2835 does, on the Pi 5 too) and the RP1 peripherals' table of functions; Jetson.GPIO's pin
table (chips and header pins of Nano, Orin NX, Orin Nano, AGX Orin); kernel,
Documentation/driver-api/pin-control.rst and drivers/pwm/core.c (their files in debugfs).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

TREE = Path("/proc/device-tree")
DEBUG = Path("/sys/kernel/debug")
"""Only root can read it."""
CONFIG_TXT = "/boot/firmware/config.txt"
JETSON_IO = "sudo /opt/nvidia/jetson-io/jetson-io.py"
FOUR_CHANNELS = "docs/pwm-pi5-4chan.dts"
_FREED_BY = {
    "spi": f"dtparam=spi=off in {CONFIG_TXT} frees it",
    "onewire": f"take dtoverlay=w1-gpio out of {CONFIG_TXT}",
}
"""Steps on a Raspberry Pi, by the beginning of the owner's name."""


@dataclass(frozen=True, slots=True)
class Carrier:
    """A pin that can carry a PWM channel."""

    chip: str
    """Name of the PWM chip's device."""
    channel: int
    pin: str
    number: int = 0
    function: int = 0
    """For a Raspberry Pi: the overlay's `pin` and `func`."""


def _pi(chip: str, *rows: tuple[int, int, int]) -> tuple[Carrier, ...]:
    return tuple(Carrier(chip, channel, f"GPIO{pin}", pin, func) for channel, pin, func in rows)


def _jetson(*rows: tuple[str, int, int]) -> tuple[Carrier, ...]:
    return tuple(Carrier(chip, channel, f"header pin {pin}") for chip, channel, pin in rows)


_PI_ROWS = ((0, 12, 4), (1, 13, 4), (0, 18, 2), (1, 19, 2))
_PI5_ROWS = ((0, 12, 4), (1, 13, 4), (2, 18, 2), (3, 19, 2))
_BOARDS = (
    ("brcm,bcm2712", _pi("1f00098000.pwm", *_PI5_ROWS)),
    ("brcm,bcm2711", _pi("fe20c000.pwm", *_PI_ROWS)),
    ("brcm,bcm2837", _pi("3f20c000.pwm", *_PI_ROWS)),
    ("brcm,bcm2836", _pi("3f20c000.pwm", *_PI_ROWS)),
    ("brcm,bcm2835", _pi("2020c000.pwm", *_PI_ROWS)),
    ("nvidia,p3450", _jetson(("7000a000.pwm", 0, 32), ("7000a000.pwm", 2, 33))),
    ("nvidia,jetson-nano", _jetson(("7000a000.pwm", 0, 32), ("7000a000.pwm", 2, 33))),
    ("p3767", _jetson(("3280000.pwm", 0, 15), ("32e0000.pwm", 0, 32), ("32c0000.pwm", 0, 33))),
    ("p3701", _jetson(("3280000.pwm", 0, 15), ("32c0000.pwm", 0, 18))),
)
"""Part of a board's name in the device tree, and the pins there, the plainer ones first."""


_WITHOUT_PULLS = "tegra"
"""Beginning of the chips' labels on all Jetsons. Their driver has no bias, and the kernel does not
report that as an error: gpio_set_bias of drivers/gpio/gpiolib.c, tegra186_gpio_set_config."""


def why_no_pull(label: str) -> str:
    """Return why a line of that chip cannot be pulled, and what to do; "": it can, as far as
    known."""
    if not label.startswith(_WITHOUT_PULLS):
        return ""
    return (
        f'the chip "{label}" has no pulls that Linux can switch on, and Linux does not report '
        "that: an open line would float, and an open contact would not stop. Add a resistor "
        "(pull up: from the line to 3.3 V; down: to ground), and set pull = false (of an "
        'encoder: "none")'
    )


def _compatible(tree: Path) -> str:
    try:
        return (tree / "compatible").read_text(errors="replace")
    except OSError:
        return ""  # a machine without a device tree


def _carriers(tree: Path) -> tuple[Carrier, ...]:
    names = _compatible(tree)
    return next((carriers for part, carriers in _BOARDS if part in names), ())


def pwm_step(
    chip: str, channels: Iterable[int], used: Collection[str] = (), tree: Path = TREE
) -> str:
    """Return, in a sentence, how pins of this machine get to carry these channels of the chip (part
    of its device's path). `used`: GPIO lines that the robot file uses otherwise."""
    names, carriers = _compatible(tree), _carriers(tree)
    if not carriers:
        if "nvidia," in names:
            return f"Give the pins to PWM with {JETSON_IO}, and start again"
        return "The board's device tree must give a pin to PWM"
    fitting = [carrier for carrier in carriers if chip in carrier.chip]
    there = ", ".join(dict.fromkeys(carrier.chip for carrier in carriers))
    other = "" if fitting else f"pwm_chip of this board: {there}. "
    chosen = []
    for channel in sorted(set(channels)):
        may = [each for each in fitting or carriers if each.channel == channel]
        free = [each for each in may if each.pin not in used]
        if not may:
            known = ", ".join(f"pwm{each.channel} on {each.pin}" for each in fitting or carriers)
            return f"{other}No pin of this board carries its pwm{channel}; there are {known}"
        chosen.append((free or may)[0])
    return other + (_overlay(chosen) if chosen[0].number else _header(chosen))


def _overlay(chosen: list[Carrier]) -> str:
    pins = " and ".join(f"pwm{each.channel} on {each.pin}" for each in chosen)
    first, *more = chosen
    text = f"pin={first.number},func={first.function}"
    if len(more) > 1:
        return f"For {pins} this board needs an overlay of your own: see {FOUR_CHANNELS}"
    if more:
        second = more[0]
        text = f"pwm-2chan,{text},pin2={second.number},func2={second.function}"
    else:
        text = f"pwm,{text}"
    return f"For {pins} add dtoverlay={text} to {CONFIG_TXT} and start again"


def _header(chosen: list[Carrier]) -> str:
    pins = " and ".join(each.pin for each in chosen)
    return f"Give {pins} to PWM with {JETSON_IO}, and start again"


def freeing_step(owner: str, tree: Path = TREE) -> str:
    """Return how to free a pin or channel from a driver of the kernel, in a clause."""
    names = _compatible(tree)
    if "brcm,bcm2" in names:
        other = f"take the dtoverlay or dtparam that gives it away out of {CONFIG_TXT}"
        return next((step for name, step in _FREED_BY.items() if owner.startswith(name)), other)
    if "nvidia," in names:
        return f"give it back with {JETSON_IO}"
    return "take that driver out of the device tree"


def pwm_owner(device: str, channel: int, debug: Path = DEBUG) -> str:
    """Return the kernel's driver that has a channel; "": no driver, or that cannot be read."""
    block = ""
    for row in _rows(debug / "pwm"):
        if not row.startswith(" "):
            block = row
        elif device in block and (found := re.match(rf" pwm-{channel}\s+\((.*?)\s*\):", row)):
            return "" if found[1] in ("(null)", "sysfs") else found[1]
    return ""


def mux_owner(label: str, offset: int, debug: Path = DEBUG) -> str:
    """Return the device that has a pin of the controller with that label; "": no device, or that
    cannot be read."""
    for folder in _folders(debug, label):
        for row in _rows(folder / "pinmux-pins"):
            found = re.match(rf"pin {offset} \(\S+\): (?:device )?([^\s(]\S*)", row)
            if found and found[1] not in ("GPIO", "UNCLAIMED"):
                return found[1]
    return ""


def not_muxed(
    device: str, channels: Collection[int], tree: Path = TREE, debug: Path = DEBUG
) -> str:
    """Return a sentence if the kernel reports that no pin carries a channel of this chip; "": one
    does, or that cannot be read."""
    shown = [row for folder in _folders(debug) for row in _rows(folder / "pinmux-pins")]
    carriers = [each for each in _carriers(tree) if each.chip == device and each.number]
    dark = []
    for channel in sorted(set(channels)):
        pins = [each.number for each in carriers if each.channel == channel]
        rows = [row for row in shown if any(row.startswith(f"pin {pin} (") for pin in pins)]
        if rows and not any(f" {device} " in row for row in rows):
            dark.append(channel)
    if not dark:
        return ""
    which = ", ".join(f"pwm{channel}" for channel in dark)
    step = pwm_step(device, channels, (), tree)
    return f"the kernel has given no pin to {which} of {device}. {step}"


def _folders(debug: Path, label: str = "") -> list[Path]:
    try:
        return [path for path in sorted((debug / "pinctrl").iterdir()) if label in path.name]
    except OSError:
        return []  # no permission


def _rows(path: Path) -> list[str]:
    try:
        return path.read_text(errors="replace").splitlines()
    except OSError:
        return []  # no permission
