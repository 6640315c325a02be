# SPDX-License-Identifier: Apache-2.0
"""A gamepad at this machine, with the settings of an [input.*] of kind "joystick". It commands
while its dead-man button is held."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing

from motord.bus.joystick.device import codes_of, find_device, stick_of
from motord.config import JoystickInput


class EvdevGamepad:
    """Implements Gamepad for one device, from its opening until it is unplugged."""

    def __init__(self, section: JoystickInput) -> None:
        """Open the device. Raise OSError, or ValueError for an axis that it does not have."""
        self._codes = codes_of(section)
        self._device = find_device(section.device)
        try:
            self._stick = stick_of(self._device, section, self._codes)
        except (OSError, ValueError):
            self._device.close()
            raise

    def twist(self) -> tuple[float, ...] | None:
        """Implement `Gamepad.twist`."""
        return self._stick.twist() if self._stick.held else None

    async def run(self, estop: Callable[[], None]) -> None:
        """Implement `Gamepad.run`."""
        with closing(self._device):
            try:
                async for event in self._device.async_read_loop():
                    if self._stick.take(event.type, event.code, event.value):
                        estop()
                    if self._stick.doubted:
                        self._stick.doubted = False
                        if self._codes.estop in self._device.active_keys():
                            estop()
            finally:
                self._stick.let_go()
