# SPDX-License-Identifier: Apache-2.0
"""A CAN line of scripted ODrives, on either engine."""

import math

import can

from motord.config.drives.load import find_profile
from motord_hal.can.bus import CanBus
from motord_hal.fieldbus.ports import (
    JointSpec,
    LineSpec,
)

TURN = 2 * math.pi


def joints(*nodes, profile="odrive-0.5"):
    return tuple(
        JointSpec(
            index=index, name=f"wheel{node}", profile=find_profile(profile), unit=node,
            inverted=index == 1, gear_ratio=2.0 if index == 1 else 1.0,
        )
        for index, node in enumerate(nodes)
    )  # fmt: skip


def spec_of(peer, *nodes, **changes):
    values = {
        "index": 0, "name": "can0", "kind": "can", "port": peer.address, "baudrate": 500000,
        "parity": "none", "stop_bits": 1, "cycle_hz": 100.0, "gap_s": None, "engine": peer.engine,
        "joints": joints(*(nodes or peer.axes)), "watchdog_s": 0.5, "priority": 0,
    }  # fmt: skip
    return LineSpec(**{**values, **changes})


class FullBus(can.bus.BusABC):
    """A bus whose `send` raises an error of python-can: its queue is full, or it was pulled."""

    def __init__(self, error):
        super().__init__("full")
        self.error = error

    def send(self, msg, timeout=None):
        raise self.error

    def _recv_internal(self, timeout):
        return None, False


def bus_that(error):
    bus = CanBus("virtual:full", 500000, None, [], lambda message, stamp_ns: None)
    bus._bus = FullBus(error)
    return bus
