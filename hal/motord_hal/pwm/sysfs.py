# SPDX-License-Identifier: Apache-2.0
"""PWM channels of /sys/class/pwm: found by the chip's device, set up in the order that the kernel
needs, left disabled.

Source: kernel, Documentation/driver-api/pwm.rst and drivers/pwm/sysfs.c (6.1). A write changes one
field and applies the whole state, so the period comes before everything else, and a duty above the
new period would be refused; `unexport` stops nothing; the owner of new files is set by udev after
the write to `export` has returned.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
from dataclasses import dataclass
from pathlib import Path

from motord_hal.base.clock import now_s
from motord_hal.base.errors import PortError
from motord_hal.gpio.pinmux import freeing_step, pwm_owner
from motord_hal.pwm.claim import claim

CLASS = Path("/sys/class/pwm")
SOFTWARE_DRIVER = "pwm-gpio"
WRITABLE_WITHIN_S = 2.0
"""Time limit until udev has given the files of a new channel to their group."""
LOOK_EVERY_S = 0.01


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel that is set up. This object owns the descriptor of `duty_cycle`, which keeps other
    programs from the channel."""

    folder: Path
    duty_fd: int
    rests_low: bool = True

    def close(self) -> None:
        """End the pulses, then release the channel. The caller sets the last value. A channel that
        rests high stays enabled: disabled it would be low, and an active-low pin would have power.
        Raises PortError if pulses may continue; the channel is released then, too."""
        try:
            if self.rests_low:
                (self.folder / "enable").write_text("0")
        except OSError as error:
            if error.errno not in (errno.ENODEV, errno.ENOENT):  # gone, and its pulses too
                raise PortError(f"{self.folder}: enable: {error.strerror}") from error
        finally:
            os.close(self.duty_fd)


class ChipAbsent(PortError):
    """No such PWM chip exists."""


def find_chip(wanted: str, root: Path = CLASS) -> Path:
    """Return the chip whose device has `wanted` in its path (the numbers of chips change from boot
    to boot), or pwmchipN by its number, or a folder by its whole path. Raises ChipAbsent, or
    PortError if several fit."""
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
    if found:
        raise PortError(f'{len(found)} PWM chips fit "{wanted}"; there: {there}')
    raise ChipAbsent(f'no PWM chip "{wanted}"; there: {there or "none"}')


def made_in_software(chip: Path) -> bool:
    """Whether timer interrupts of the kernel make the chip's pulses on a GPIO line
    (drivers/pwm/pwm-gpio.c, Linux 6.11)."""
    return Path(os.path.realpath(chip / "device" / "driver")).name == SOFTWARE_DRIVER


async def open_channel(chip: Path, number: int, period_ns: int, rest_ns: int) -> Channel:
    """Export and claim a channel, bring it to rest, and enable it at `rest_ns` of `period_ns`.
    Raises PortError. A channel that another program drives is not touched."""
    folder = chip / f"pwm{number}"
    with contextlib.ExitStack() as undo:
        try:
            _export(chip, number, folder)
            await _until_writable(folder)
            fd = os.open(folder / "duty_cycle", os.O_WRONLY | os.O_CLOEXEC)
            undo.callback(os.close, fd)
            claim(fd)
            _set_up(folder, period_ns, rest_ns)
        except OSError as error:
            what = f"PWM channel {number} of {chip} ({device_of(chip)})"
            raise PortError(f"{what}: {_why(error, chip, number)}") from error
        undo.pop_all()
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
    """Set a channel up, which may still run as its last user left it: first end its pulses. A
    channel that rests high stays as high meanwhile as the old and the new period allow."""
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


def device_of(chip: Path) -> str:
    """Return the name of a chip's device."""
    return Path(os.path.realpath(chip / "device")).name


def _why(error: OSError, chip: Path, number: int) -> str:
    if error.errno == errno.EBUSY:
        owner = pwm_owner(device_of(chip), number)
        who = owner or "a fan, a backlight"
        return f"a driver of the kernel has it ({who}): {freeing_step(owner)}"
    if error.errno == errno.ENODEV:
        return _how_many(chip)
    if error.errno == errno.EINVAL:
        return "this chip cannot make pulses at that frequency (line's pwm_hz)"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "no permission: put this user into the group gpio, or see the udev rules"
    return error.strerror or str(error)


def _how_many(chip: Path) -> str:
    try:
        return f"the chip has {(chip / 'npwm').read_text().strip()} channels, from 0 on"
    except OSError:
        return "the chip is gone"
