# SPDX-License-Identifier: Apache-2.0
"""Where a simulated CAN bus is: any that python-can reaches, or unix:PATH."""

from __future__ import annotations

import math
import socket
from dataclasses import dataclass

import can

from motord_hal.can.address import bus_arguments, split_address
from motord_hal.sim.can.unix_bus import UnixBus

GROUP = "239.74.163.2"
"""Of python-can's documentation for UDP multicast (IPv4, administratively scoped: RFC 2365)."""
POLL_S = 0.001
"""For CAN buses without a descriptor."""


@dataclass(frozen=True, slots=True)
class BusSettings:
    bitrate: int
    data_bitrate: int | None


def free_address() -> str:
    """A CAN bus of UDP datagrams on this machine, without other users."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"udp_multicast:{GROUP}:{probe.getsockname()[1]}"


class CanPort:
    """One end of a CAN bus. Nothing here waits."""

    def __init__(self, address: str, settings: BusSettings) -> None:
        self._address = address
        self._arguments = bus_arguments(address, settings.bitrate, settings.data_bitrate)
        self._bus: can.BusABC | None = None
        self._fd: int | None = None

    @property
    def address(self) -> str:
        return self._address

    @property
    def plugged(self) -> bool:
        return self._bus is not None

    def plug(self) -> None:
        """Open it. Raises OSError."""
        interface, channel = split_address(self._address)
        if interface == "unix":
            self._bus = UnixBus(channel)
            self._fd = self._bus.fileno()
            return
        try:
            self._bus = can.Bus(**self._arguments)
        except can.CanError as error:
            raise OSError(error.error_code or 0, str(error), self._address) from error
        try:
            self._fd = self._bus.fileno()
        except RuntimeError:  # python-can: the adapter has none
            self._fd = None

    def pull(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    def filenos(self, now_s: float) -> list[int]:
        del now_s
        return [self._fd] if self._bus is not None and self._fd is not None else []

    def due_s(self, now_s: float) -> float:
        """When to look without a ready file."""
        return now_s + POLL_S if self._bus is not None and self._fd is None else math.inf

    def take_in(self) -> can.Message | None:
        """The next frame that has come."""
        try:
            return None if self._bus is None else self._bus.recv(timeout=0)
        except (can.CanError, OSError):
            return None

    def put(self, message: can.Message) -> bool:
        """False: it was lost, as on a CAN bus that is full."""
        if self._bus is None:
            return False
        try:
            self._bus.send(message, timeout=0)
        except (can.CanError, OSError):
            return False
        return True

    def stall(self, until_s: float) -> None:
        """A CAN bus does not stall."""

    def forget(self) -> None:
        """A CAN bus has no connections."""
