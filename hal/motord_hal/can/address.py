# SPDX-License-Identifier: Apache-2.0
"""The name of a CAN bus, INTERFACE:CHANNEL, and the arguments that python-can needs for it."""

from __future__ import annotations

from typing import Any

import can

from motord_hal.base.errors import ProfileError
from motord_hal.can.adapters import FD_ADAPTERS, why_unfit


def split_address(address: str) -> tuple[str, str]:
    """Return interface and channel of INTERFACE:CHANNEL."""
    interface, _, channel = address.partition(":")
    return interface, channel


def bus_arguments(address: str, bitrate: int, data_bitrate: int | None) -> dict[str, Any]:
    """Return the arguments with which python-can opens the CAN bus. On SocketCAN the kernel sets
    the bit rate. Raises ProfileError if the adapter cannot be used."""
    interface, channel = split_address(address)
    if problem := why_unfit(interface, fd_frames=data_bitrate is not None):
        raise ProfileError(f"{address}: {problem}")
    wanted: dict[str, Any] = {"interface": interface, "channel": channel}
    if interface == "socketcan":
        return {**wanted, "fd": data_bitrate is not None}
    if interface == "udp_multicast":
        group, _, port = channel.rpartition(":")
        return {**wanted, "channel": group, "port": int(port)} if group else wanted
    if interface == "virtual":
        protocol = can.CanProtocol.CAN_FD if data_bitrate else can.CanProtocol.CAN_20
        return {**wanted, "protocol": protocol}
    if interface == "slcan":  # its driver would wait a millisecond for a frame that is not there
        wanted["timeout"] = 0
    if data_bitrate is not None and interface in FD_ADAPTERS:
        wanted |= {"fd": True, "data_bitrate": data_bitrate}
    return {**wanted, "bitrate": bitrate}
