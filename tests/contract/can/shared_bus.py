# SPDX-License-Identifier: Apache-2.0
"""A CAN bus with room for several drives, each with an end of its own, and a line of any engine."""

import contextlib
import threading

import can
from scripted_odrive import INTERFACE, new_address

from motord_hal.can.address import bus_arguments, split_address
from motord_hal.can.unix_client import UnixClient
from motord_hal.sim.can.unix_bus import UnixBus

KINDS = (
    [("socketcan", "asyncio"), ("socketcan", "rt")]
    if INTERFACE
    else [("udp_multicast", "asyncio"), ("unix", "asyncio"), ("unix", "rt")]
)
"""Kinds of buses, each with the engine of the line on it."""


@contextlib.contextmanager
def shared_bus(kind):
    """Yield the address of a new bus. For a bus at a Unix socket a thread passes the frames on."""
    address = new_address(kind)
    if kind != "unix":
        yield address
        return
    bus, ended = UnixBus(split_address(address)[1]), threading.Event()

    def hand_on():
        while not ended.is_set():
            bus.recv(timeout=0.05)

    handing_on = threading.Thread(target=hand_on)
    handing_on.start()
    try:
        yield address
    finally:
        ended.set()
        handing_on.join()
        bus.shutdown()


class End(UnixClient):
    """An end that drops a frame which the bus does not take at once, as a drive does: on a busy
    machine the bus may be unread until its buffer is full."""

    def send(self, msg, timeout=None):
        with contextlib.suppress(BlockingIOError):
            super().send(msg, timeout)


def end_of(address, bitrate=500_000, data_bitrate=None):
    """Open one more end of the bus."""
    interface, channel = split_address(address)
    if interface == "unix":
        return End(channel)
    return can.Bus(**bus_arguments(address, bitrate, data_bitrate))
