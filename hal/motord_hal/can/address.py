# SPDX-License-Identifier: Apache-2.0
"""The name of a bus, INTERFACE:CHANNEL, and what python-can wants to know of it."""

from __future__ import annotations

from typing import Any

import can


def split_address(address: str) -> tuple[str, str]:
    """Interface and channel of INTERFACE:CHANNEL."""
    interface, _, channel = address.partition(":")
    return interface, channel


def bus_arguments(address: str, bitrate: int, data_bitrate: int | None) -> dict[str, Any]:
    """What python-can wants to know to open it. On SocketCAN the bit rate is the kernel's."""
    interface, channel = split_address(address)
    wanted: dict[str, Any] = {"interface": interface, "channel": channel}
    if interface == "socketcan":
        return {**wanted, "fd": data_bitrate is not None}
    if interface == "udp_multicast":
        group, _, port = channel.rpartition(":")
        return {**wanted, "channel": group, "port": int(port)} if group else wanted
    if interface == "virtual":
        protocol = can.CanProtocol.CAN_FD if data_bitrate else can.CanProtocol.CAN_20
        return {**wanted, "protocol": protocol}
    return {**wanted, "bitrate": bitrate}
