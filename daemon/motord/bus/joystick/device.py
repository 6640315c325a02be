# SPDX-License-Identifier: Apache-2.0
"""A joystick that is connected to this machine (evdev). Releasing the dead-man button brings the
robot to rest and gives the lease back; so does unplugging the device.

A wireless pad whose radio fails looks like one that is held still until its driver notices.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import closing
from typing import TYPE_CHECKING

import evdev

from motord.bus.commands.link import Source
from motord.bus.commands.urgent import Urgent
from motord.bus.guard import first, raise_if_cancelled
from motord.bus.joystick.axes import Codes, Stick
from motord.config import JoystickInput
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

LOOK_AGAIN_S = 1.0

_log = logging.getLogger(__name__)


class Joystick:
    def __init__(self, name: str, section: JoystickInput, runtime: Runtime) -> None:
        """Raises ValueError for names that the kernel does not have."""
        self._name = name
        self._section = section
        self._source: Source = runtime.source(name)
        self._codes = codes_of(section)
        self._estop = Urgent(name, "estop", runtime.call)
        self._gap = runtime.gap(section.lease_s)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        async with TaskGroup() as tasks:
            tasks.create_task(self._source.run())
            tasks.create_task(self._estop.run())
            tasks.create_task(self._keep())

    async def _keep(self) -> None:
        """Look for the device and listen to it; look again when it is gone."""
        failing = False
        while True:
            try:
                with closing(find_device(self._section.device)) as device:
                    _log.info("input.%s: %s at %s", self._name, device.name, device.path)
                    failing = False
                    await self._listen(device)
            except* (OSError, ValueError) as errors:
                if not failing:
                    failing = True
                    _log.warning("input.%s: %s", self._name, first(errors))
            raise_if_cancelled()
            await asyncio.sleep(LOOK_AGAIN_S)

    async def _listen(self, device: evdev.InputDevice[str]) -> None:
        """Take the device's events until it is gone. Raises OSError then."""
        stick = stick_of(device, self._section, self._codes)
        async with TaskGroup() as tasks:
            tasks.create_task(self._command(stick))
            self._look_for_estop(device)
            async for event in device.async_read_loop():
                if stick.take(event.type, event.code, event.value):
                    self._estop.ask("by its button")
                if stick.doubted:
                    stick.doubted = False
                    self._look_for_estop(device)

    def _look_for_estop(self, device: evdev.InputDevice[str]) -> None:
        """Read the e-stop button itself, where its event may have been missed. Raises OSError."""
        if self._codes.estop in device.active_keys():
            self._estop.ask("by its button, which is held")

    async def _command(self, stick: Stick) -> None:
        """Send commands while the button is held; then send one zero, and give the lease back."""
        commanding = False
        try:
            while True:
                if self._gap.just_over():
                    stick.let_go()  # it may have been released meanwhile
                if stick.held:
                    linear_m_s, angular_rad_s, lateral_m_s = stick.twist()
                    self._source.drive(linear_m_s, angular_rad_s, lateral_m_s=lateral_m_s)
                    commanding = True
                elif commanding:
                    self._rest()
                    commanding = False
                await asyncio.sleep(1.0 / self._section.rate_hz)
        finally:
            if commanding:
                self._rest()

    def _rest(self) -> None:
        self._source.drive(0.0, 0.0)
        self._source.release()


def find_device(wanted: str) -> evdev.InputDevice[str]:
    """Find a device by its file, or by a part of its name. Raises OSError."""
    if wanted.startswith("/"):
        return evdev.InputDevice(wanted)
    for path in evdev.list_devices():
        device = evdev.InputDevice(path)
        if wanted in device.name:
            return device
        device.close()
    raise FileNotFoundError(f'no input device that we may read is named "{wanted}"')


def codes_of(section: JoystickInput) -> Codes:
    """Return the kernel's numbers for the section's names. Raises ValueError."""
    return Codes(
        dead_man=_code(section.dead_man),
        linear=_code(section.linear_axis),
        angular=_code(section.angular_axis),
        lateral=None if section.lateral_axis is None else _code(section.lateral_axis),
        estop=None if section.estop_button is None else _code(section.estop_button),
    )


def stick_of(device: evdev.InputDevice[str], section: JoystickInput, codes: Codes) -> Stick:
    """Create the `Stick` of a device. Raises OSError, and ValueError for an axis that the device
    lacks."""
    axes = (codes.linear, codes.angular, codes.lateral)
    infos = {axis: device.absinfo(axis) for axis in axes if axis is not None}
    ranges = {axis: (info.min, info.max) for axis, info in infos.items()}
    return Stick(section, codes, ranges)


def _code(name: str) -> int:
    code = evdev.ecodes.ecodes.get(name)
    if not isinstance(code, int):
        raise ValueError(f"the kernel has no {name}")
    return code
