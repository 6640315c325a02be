# SPDX-License-Identifier: Apache-2.0
"""Connection of a simulated CAN bus: any bus that python-can reaches, or unix:PATH."""

from __future__ import annotations

import math
import socket
from dataclasses import dataclass

import can

from motord_hal.can.address import bus_arguments, split_address
from motord_hal.sim.can.unix_bus import UnixBus

GROUP = "239.74.163.2"
"""Multicast group from python-can's documentation of UDP multicast (IPv4, administratively scoped:
RFC 2365)."""
POLL_S = 0.001
"""Polling interval for CAN buses without a descriptor."""


@dataclass(frozen=True, slots=True)
class BusSettings:
    bitrate: int
    data_bitrate: int | None


def free_address() -> str:
    """Return the address of a CAN bus of UDP datagrams on this machine, without other users."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"udp_multicast:{GROUP}:{probe.getsockname()[1]}"


class CanPort:
    """One end of a CAN bus. No method waits."""

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
        """Open the CAN bus. Raises OSError."""
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
        """Return the time to look for frames without a ready file."""
        return now_s + POLL_S if self._bus is not None and self._fd is None else math.inf

    def take_in(self) -> can.Message | None:
        """Return the next received frame, or None."""
        try:
            return None if self._bus is None else self._bus.recv(timeout=0)
        except (can.CanError, OSError):
            return None

    def put(self, message: can.Message) -> bool:
        """Send a frame. Return False if it was lost, as on a full CAN bus."""
        if self._bus is None:
            return False
        try:
            self._bus.send(message, timeout=0)
        except (can.CanError, OSError):
            return False
        return True

    def stall(self, until_s: float) -> None:
        """Do nothing: a CAN bus does not stall."""

    def forget(self) -> None:
        """Do nothing: a CAN bus has no connections."""
