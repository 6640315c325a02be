# SPDX-License-Identifier: Apache-2.0
"""Check of which of python-can's adapters a line can use. Pure."""

from __future__ import annotations

_FD_KINDS = ("socketcan", "unix", "virtual", "udp_multicast")
FD_ADAPTERS = ("kvaser", "vector", "ixxat")
"""Drivers of python-can that take `fd` and `data_bitrate`."""


def why_unfit(interface: str, *, fd_frames: bool) -> str:
    """Return why a line cannot use this kind of adapter, in words; "": it can."""
    if interface == "gs_usb":
        # python-can's GsUsbBus.send has no time-out, and the event loop would wait in it
        text = "python-can's gs_usb driver waits without end where the CAN bus takes nothing"
        return f'{text}: use the kernel\'s gs_usb driver: interface = "socketcan", channel = "can0"'
    if fd_frames and interface not in (*_FD_KINDS, *FD_ADAPTERS):
        others = ", ".join((*_FD_KINDS, *FD_ADAPTERS))
        return f"{interface} carries no CAN FD (data_bitrate): it goes over {others}"
    return ""
