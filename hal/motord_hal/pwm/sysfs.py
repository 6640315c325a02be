# SPDX-License-Identifier: Apache-2.0
"""PWM channels of /sys/class/pwm: found by the chip's device, set up in the order that the kernel
takes, left disabled.

Source: kernel, Documentation/driver-api/pwm.rst and drivers/pwm/sysfs.c (6.1). A write changes one
field and applies the whole state, so the period comes before everything else, and a duty above the
new period would be refused; `unexport` stops nothing; the owner of new files is set by udev after
the write to `export` has returned.
"""

from __future__ import annotations

import asyncio
import errno
import os
from dataclasses import dataclass
from pathlib import Path

from motord_hal.clock import now_s
from motord_hal.errors import PortError

CLASS = Path("/sys/class/pwm")
MODEL = Path("/proc/device-tree/model")
SOFTWARE_DRIVER = "pwm-gpio"
WRITABLE_WITHIN_S = 2.0
"""Until udev has given the files of a new channel to their group."""
LOOK_EVERY_S = 0.01


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel that is set up. The descriptor of `duty_cycle` is this object's."""

    folder: Path
    duty_fd: int
    rests_low: bool = True

    def close(self) -> None:
        """No pulses, then let it go. What the channel was told last is the caller's care. One that
        rests high stays enabled: disabled it would be low, and an active-low pin have power."""
        os.close(self.duty_fd)
        if not self.rests_low:
            return
        try:
            (self.folder / "enable").write_text("0")
        except OSError:
            return  # the chip is gone, and its pulses with it


def find_chip(wanted: str, root: Path = CLASS, model: Path = MODEL) -> Path:
    """The chip whose device has `wanted` in its path (the numbers of chips change from boot to
    boot), or pwmchipN by its number, or a folder by its whole path. Raises PortError."""
    if wanted.startswith("/"):
        return Path(wanted)
    chips = {path.name: path.resolve() for path in sorted(root.glob("pwmchip*"))}
    if wanted in chips:
        return chips[wanted]
    devices = {name: os.path.realpath(path / "device") for name, path in chips.items()}
    found = [name for name, device in devices.items() if wanted in device]
    if len(found) == 1:
        return chips[found[0]]
    there = ", ".join(f"{name} ({Path(device).name})" for name, device in devices.items())
    what = f"{len(found)} PWM chips fit" if found else "no PWM chip"
    text = f'{what} "{wanted}"; there: {there or "none"}'
    raise PortError(text if found else f"{text}. {overlay_hint(model)}")


def made_in_software(chip: Path) -> bool:
    """Whether timer interrupts of the kernel make the chip's pulses on a GPIO line
    (drivers/pwm/pwm-gpio.c, Linux 6.11)."""
    return Path(os.path.realpath(chip / "device" / "driver")).name == SOFTWARE_DRIVER


def overlay_hint(model: Path = MODEL) -> str:
    """What makes the pins of this machine carry PWM."""
    try:
        name = model.read_text(errors="replace").rstrip("\0")
    except OSError:
        name = ""
    if "Raspberry Pi" in name:
        overlay = "dtoverlay=pwm-2chan,pin=12,func=4,pin2=13,func2=4"
        return f"Add {overlay} to /boot/firmware/config.txt and start again"
    if "Jetson" in name or "NVIDIA" in name:
        return "Give the pins to PWM with: sudo /opt/nvidia/jetson-io/jetson-io.py"
    return "The board's device tree must give a pin to PWM"


async def open_channel(chip: Path, number: int, period_ns: int, rest_ns: int) -> Channel:
    """Export it, let it rest, and enable it at `rest_ns` of `period_ns`. Raises PortError."""
    folder = chip / f"pwm{number}"
    try:
        _export(chip, number, folder)
        await _until_writable(folder)
        _set_up(folder, period_ns, rest_ns)
        fd = os.open(folder / "duty_cycle", os.O_WRONLY | os.O_CLOEXEC)
    except OSError as error:
        what = f"PWM channel {number} of {chip} ({_device(chip)})"
        raise PortError(f"{what}: {_why(error, chip)}") from error
    return Channel(folder, fd, rests_low=rest_ns == 0)


def _export(chip: Path, number: int, folder: Path) -> None:
    if not folder.exists():
        (chip / "export").write_text(str(number))


async def _until_writable(folder: Path) -> None:
    give_up_s = now_s() + WRITABLE_WITHIN_S
    files = [folder / name for name in ("period", "duty_cycle", "enable", "polarity")]
    while not all(os.access(path, os.W_OK) for path in files):
        if now_s() > give_up_s:
            raise PermissionError(errno.EACCES, f"{folder} is not writable for this user")
        await asyncio.sleep(LOOK_EVERY_S)


def _set_up(folder: Path, period_ns: int, rest_ns: int) -> None:
    """A channel may be running still, as its last user left it: first its pulses end. One that
    rests high stays as high meanwhile as the old and the new period let it be."""
    old_ns = int((folder / "period").read_text())
    if old_ns > 0 and rest_ns > 0:
        (folder / "duty_cycle").write_text(str(min(old_ns, period_ns)))
    elif old_ns > 0:
        (folder / "duty_cycle").write_text("0")
        if (folder / "enable").read_text().strip() != "0":
            (folder / "enable").write_text("0")
    (folder / "period").write_text(str(period_ns))
    if (folder / "polarity").read_text().strip() != "normal":
        (folder / "polarity").write_text("normal")
    (folder / "duty_cycle").write_text(str(rest_ns))
    (folder / "enable").write_text("1")


def _device(chip: Path) -> str:
    return Path(os.path.realpath(chip / "device")).name


def _why(error: OSError, chip: Path) -> str:
    if error.errno == errno.EBUSY:
        return "a driver of the kernel has it (a fan, a backlight): take it out of the device tree"
    if error.errno == errno.ENODEV:
        return f"the chip has {(chip / 'npwm').read_text().strip()} channels, from 0 on"
    if error.errno == errno.EINVAL:
        return "this chip cannot make pulses at that frequency (line's pwm_hz)"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "no permission: put this user into the group gpio, or see the udev rules"
    return error.strerror or str(error)
