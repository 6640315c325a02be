# SPDX-License-Identifier: Apache-2.0
"""Checks of the devices in a robot file: whether they exist, whether this user may open them,
whether they are set up as in the file, and whether another program has them open."""

from __future__ import annotations

import grp
import os
import re
from collections.abc import Collection, Iterator
from pathlib import Path

from motord.config import Robot
from motord.config.rules.bus import missing_packages
from motord.config.sections.line import CanLine, PortLine, PwmLine, SerialLine
from motord.tools.doctor.finding import Finding, Fix, Root, Run, Verdict, Write
from motord.tools.doctor.machine import permitted, user
from motord_hal.base.errors import PortError
from motord_hal.can.interface import IFF_UP
from motord_hal.gpio.pinmux import freeing_step, mux_owner, not_muxed, pwm_step
from motord_hal.pwm.sysfs import ChipAbsent, device_of, find_chip
from motord_hal.serial.latency import UDEV_LINE
from motord_hal.serial.sysfs import device_file, holders

_NUMBERED = re.compile(r"/dev/tty(USB|ACM)\d+")
TIMER_MS = 1
UDEV_RULES = "/etc/udev/rules.d/99-motord.rules"


def look(root: Root, robot: Robot | None, daemon_pids: Collection[int] = ()) -> Iterator[Finding]:
    """Check the devices of the robot file; without one, the latency timers of all adapters.
    `daemon_pids` are the processes that may have the devices open."""
    if robot is None:
        for timer in root.glob("/sys/class/tty/*/device/latency_timer"):
            yield from _timer(root, f"/dev/{timer.parts[-3]}")
        return
    for name, line in robot.line.items():
        where = f"line.{name}"
        if isinstance(line, CanLine):
            if line.interface == "socketcan":
                yield from _can(root, where, line.channel, line.bitrate)
        elif isinstance(line, PwmLine):
            yield from _pwm(root, where, line, robot, name)
        elif isinstance(line, SerialLine | PortLine):
            yield from _serial(root, where, line.port, daemon_pids)
    for place, package, how in missing_packages(robot):
        yield Finding(
            group="extra", check=".".join(map(str, place[:2])), verdict="fail",
            text=f"needs {package}, which is not installed: it is off", mend=how,
        )  # fmt: skip


def _device(
    check: str, verdict: Verdict, text: str, mend: str = "", fixes: tuple[Fix, ...] = ()
) -> Finding:
    return Finding(group="device", check=check, verdict=verdict, text=text, mend=mend, fixes=fixes)


# ------------------------------------------------------------------------------------- serial ports
def _serial(root: Root, where: str, port: str, daemon_pids: Collection[int]) -> Iterator[Finding]:
    try:
        named = device_file(port)
    except PortError as error:
        yield _device(where, "fail", str(error), "plug the adapter in; ls -l /dev/serial/by-id")
        return
    path = root.path(named)
    if not path.exists():
        mend = "plug the adapter in; ls -l /dev/serial/by-id"
        yield _device(where, "fail", f"{named} does not exist", mend)
        return
    if not permitted(root, path):
        group = _group(root, path.stat().st_gid)
        yield _device(
            where, "fail", f"{user(root)} may not open {named}: it is for the group {group}",
            f"sudo usermod -aG {group} {user(root)}, and log in again",
        )  # fmt: skip
        return
    others = [
        holder
        for holder in holders(str(path), root.path("/proc"))
        if not any(holder.endswith(f"(pid {pid})") for pid in daemon_pids)
    ]
    if others:
        pids = " ".join(re.findall(r"\(pid (\d+)\)", " ".join(others)))
        text = f"{named} is also open in {', '.join(others)}: two programs on one line"
        yield _device(where, "fail", text, f"end it: kill {pids}")
        return
    if _NUMBERED.fullmatch(port):
        text = f"{port} may be another adapter after the next start"
        mend = f"in the robot file: port = the link of {port} in /dev/serial/by-id, or usb:SERIAL"
        yield _device(where, "warn", text, mend)
    else:
        yield _device(where, "ok", f"{named} is there and ours to open")
    yield from _timer(root, named)


def _group(root: Root, number: int) -> str:
    rows = (row.split(":") for row in root.text("/etc/group").splitlines())
    found = [row[0] for row in rows if len(row) > 2 and row[2] == str(number)]
    if found:
        return found[0]
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _timer(root: Root, device: str) -> Iterator[Finding]:
    """Check the latency timer of an adapter; only FTDI adapters have one."""
    name = Path(os.path.realpath(root.path(device))).name
    file = f"/sys/class/tty/{name}/device/latency_timer"
    timer_ms = root.number(file)
    if timer_ms is None:
        return
    check = f"{name} latency timer"
    if timer_ms <= TIMER_MS:
        yield _device(check, "ok", f"{timer_ms} ms")
        return
    yield _device(
        check, "warn", f"the adapter holds replies back for up to {timer_ms} ms",
        f"for good: echo '{UDEV_LINE}' | sudo tee -a {UDEV_RULES}",
        (Write(path=root.path(file), value=str(TIMER_MS)),),
    )  # fmt: skip


# ---------------------------------------------------------------------------------------------- CAN
def _can(root: Root, where: str, channel: str, bitrate: int) -> Iterator[Finding]:
    flags = root.number(f"/sys/class/net/{channel}/flags")
    if flags is None:
        mend = "ip -details link; plug the adapter in, or load its driver"
        yield _device(where, "fail", f"there is no CAN interface {channel}", mend)
        return
    up = Run(words=("ip", "link", "set", channel, "up", "type", "can", "bitrate", str(bitrate)))
    if not flags & IFF_UP:
        yield _device(where, "fail", f"{channel} is down", str(up), (up,))
        return
    try:
        found = root.ask_bit_rate(channel)
    except OSError as error:
        yield _device(where, "warn", f"{channel}: its bit rate is not known: {error}")
        return
    if found is not None and found != bitrate:
        text = f"{channel} has {found} bit/s, the robot file {bitrate}: no frame gets through"
        yield _device(where, "fail", text, f"sudo ip link set {channel} down; {up}")
        return
    what = f"{found} bit/s" if found is not None else "a virtual CAN bus without a bit rate"
    yield _device(where, "ok", f"{channel} is up, {what}")


# ---------------------------------------------------------------------------------------------- PWM
def _functions(root: Root, where: str, pins: Collection[str]) -> Iterator[Finding]:
    """Find GPIO lines of a Raspberry Pi that belong to another device. The kernel shows this only
    to root."""
    tree, debug = root.path("/proc/device-tree"), root.path("/sys/kernel/debug")
    if "brcm,bcm2" not in root.text("/proc/device-tree/compatible"):
        return
    for pin in sorted(set(pins)):
        number = re.fullmatch(r"GPIO(\d+)", pin)
        if number and (owner := mux_owner("", int(number[1]), debug)):
            text = f"{pin} belongs to {owner}: it does not work as a GPIO line"
            yield _device(f"{where} {pin}", "fail", text, freeing_step(owner, tree))


def _pwm(root: Root, where: str, line: PwmLine, robot: Robot, name: str) -> Iterator[Finding]:
    pins = [
        pin.removeprefix("!")
        for joint in robot.joint.values()
        if joint.line == name
        for pin in joint.pins.values()
    ]
    yield from _functions(root, where, pins)
    if line.pwm_chip is None:
        return
    channels = {int(pin[3:]) for pin in pins if re.fullmatch(r"pwm\d+", pin)}
    tree = root.path("/proc/device-tree")
    try:
        chip = find_chip(line.pwm_chip, root.path("/sys/class/pwm"))
    except ChipAbsent as error:
        step = pwm_step(line.pwm_chip, channels, pins, tree)
        yield _device(where, "fail", str(error), step)
        return
    except PortError as error:
        yield _device(where, "fail", str(error), "name the chip's whole device in pwm_chip")
        return
    device = device_of(chip)
    doubt = not_muxed(device, channels, tree, root.path("/sys/kernel/debug"))
    if doubt:
        problem, _, step = doubt.partition(". ")
        yield _device(where, "fail", problem, step)
        return
    count = root.number(f"/{(chip / 'npwm').relative_to(root.root)}")
    missing = [channel for channel in sorted(channels) if count is not None and channel >= count]
    if missing:
        text = f"{device} has {count} channels, and no pwm{missing[0]}"
        yield _device(where, "fail", text, pwm_step(line.pwm_chip, channels, pins, tree))
        return
    yield _device(where, "ok", f"{device} carries {', '.join(f'pwm{n}' for n in sorted(channels))}")
