# SPDX-License-Identifier: Apache-2.0
"""ODrive axes on a CAN bus that send raw frames, written from the protocol's own table; they share
no code with motord."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
import tempfile
import time
from dataclasses import dataclass, field

import can

from motord_hal.sim.can.unix_bus import UnixBus

VERSION, HEARTBEAT, ESTOP, MOTOR_ERROR, STATE, ESTIMATES = 0x00, 0x01, 0x02, 0x03, 0x07, 0x09
MODE, INPUT_POSITION, INPUT_VELOCITY, IQ, BUS, CLEAR = 0x0B, 0x0C, 0x0D, 0x14, 0x17, 0x18
IDLE, CLOSED_LOOP = 1, 8
VELOCITY_CONTROL, POSITION_CONTROL = 2, 3
HEARTBEAT_S, ESTIMATES_S = 0.05, 0.01
INTERFACE = os.environ.get("MOTORD_CAN_INTERFACE")
"""A CAN interface of the kernel, up and used by these tests alone; None: buses without one."""
BUSES = (
    {"socketcan": "rt", "socketcan-asyncio": "asyncio"}
    if INTERFACE
    else {"virtual": "asyncio", "udp_multicast": "asyncio", "unix": "rt"}
)
"""Kinds of buses, each with the engine of a line on it."""


def free_udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


def new_address(kind):
    """Return the address of a new bus (SocketCAN: of INTERFACE) as a robot file's line names it."""
    if kind.startswith("socketcan"):
        return f"socketcan:{INTERFACE}"
    if kind == "virtual":
        return f"virtual:{time.monotonic_ns()}"
    if kind == "unix":
        return f"unix:{tempfile.mkdtemp()}/bus"
    return f"udp_multicast:239.74.163.2:{free_udp_port()}"


def engine_asked(kind):
    """Return the engine setting of a line on such a bus."""
    return "asyncio" if kind.endswith("-asyncio") else "auto"


def open_bus(address):
    """Open and return the far end of a bus; return one that is open already as it is."""
    if not isinstance(address, str):
        return address
    interface, _, channel = address.partition(":")
    if interface in ("virtual", "socketcan"):
        return can.Bus(interface=interface, channel=channel)
    if interface == "unix":
        return UnixBus(channel)
    group, _, port = channel.rpartition(":")
    return can.Bus(interface=interface, channel=group, port=int(port))


@dataclass
class Axis:
    """State of one axis, and what it was sent."""

    state: int = IDLE
    error: int = 0
    position_turns: float = 0.0
    velocity_turns_s: float = 0.0
    voltage_v: float = 24.0
    current_a: float = 0.0
    mode: tuple[int, int] = (3, 1)
    silent: bool = False
    no_estimates: bool = False
    no_heartbeat: bool = False
    ignored: set[int] = field(default_factory=set)
    """Commands that have no effect, as if lost in transit; `received` records them."""
    stuck: bool = False
    """Whether the axis ignores requests to change its state."""
    input_turns: float = 0.0
    """Newest position input; with power and in position control the axis is there at once."""
    received: list[tuple[int, bytes]] = field(default_factory=list)
    """Command and data of each frame that is not a remote frame."""
    asked: list[int] = field(default_factory=list)

    def sent(self, command):
        return [data for one, data in self.received if one == command]

    def velocities(self):
        return [struct.unpack("<ff", data)[0] for data in self.sent(INPUT_VELOCITY)]

    def inputs(self):
        """Return each position input: turns, and the feed-forward of velocity and torque."""
        return [struct.unpack("<fhh", data) for data in self.sent(INPUT_POSITION)]

    def states(self):
        return [int.from_bytes(data, "little") for data in self.sent(STATE)]


class Peer:
    """ODrive axes by node number; they receive and send while `run` runs."""

    def __init__(self, kind, nodes=(0,), address="", far_end=""):
        """Use a new bus, or the one at `address`; `far_end` is the other end of its cable."""
        self.address = address or new_address(kind)
        self.kind = kind
        self.engine = engine_asked(kind)
        self.axes = {node: Axis() for node in nodes}
        self._bus = open_bus(far_end or self.address)
        self._due_s = dict.fromkeys(((n, c) for n in nodes for c in (HEARTBEAT, ESTIMATES)), 0.0)

    async def run(self):
        while True:
            if self._bus is not None:
                self._live()
            await asyncio.sleep(0.002)

    def _live(self):
        while (message := self._bus.recv(timeout=0)) is not None:
            self._take(message)
        for node, axis in self.axes.items():
            self._speak(node, axis)

    def cut(self):
        """Take the axes off the bus; frames that they have not read are lost."""
        self._bus.shutdown()
        self._bus = None

    def reach(self, address):
        """Put the axes on a bus again."""
        self._bus = open_bus(address)

    def close(self):
        if self._bus is not None:
            self._bus.shutdown()

    def send(self, node, command, data):
        self.send_raw(node << 5 | command, data)

    def send_raw(self, identifier, data, **more):
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **more)
        self._bus.send(message)

    def _speak(self, node, axis):
        now_s = time.monotonic()
        for command, every_s in ((HEARTBEAT, HEARTBEAT_S), (ESTIMATES, ESTIMATES_S)):
            if now_s >= self._due_s[node, command]:
                self._due_s[node, command] = now_s + every_s
                self.say(node, axis, command)

    def say(self, node, axis, command):
        if axis.silent or (axis.no_estimates and command == ESTIMATES):
            return
        if axis.no_heartbeat and command == HEARTBEAT:
            return
        data = {
            VERSION: bytes((2, 5, 2, 0, 0, 6, 9, 0)),  # protocol 2, firmware 0.6.9
            HEARTBEAT: struct.pack("<IB3x", axis.error, axis.state),
            ESTIMATES: struct.pack("<ff", axis.position_turns, axis.velocity_turns_s),
            BUS: struct.pack("<ff", axis.voltage_v, 0.0),
            IQ: struct.pack("<ff", 0.0, axis.current_a),
            MOTOR_ERROR: bytes(8),
        }
        if command in data:
            self.send(node, command, data[command])

    def _take(self, message):
        node, command = message.arbitration_id >> 5, message.arbitration_id & 0x1F
        axis = self.axes.get(node)
        if axis is None or message.is_error_frame:
            return
        if message.is_remote_frame:
            axis.asked.append(command)
            self.say(node, axis, command)
            return
        axis.received.append((command, bytes(message.data)))
        if command in axis.ignored:
            return
        if command == STATE and not axis.stuck:
            axis.state = int.from_bytes(message.data, "little")
        elif command == MODE:
            axis.mode = struct.unpack("<II", message.data)
        elif command == INPUT_POSITION:
            axis.input_turns = struct.unpack("<fhh", message.data)[0]
        elif command == CLEAR:
            axis.error = 0
        if axis.state == CLOSED_LOOP and axis.mode[0] == POSITION_CONTROL:
            axis.position_turns = axis.input_turns


@contextlib.asynccontextmanager
async def living(peer):
    """Run the peer until the end of the block, then close it."""
    async with asyncio.TaskGroup() as group:
        task = group.create_task(peer.run())
        try:
            yield peer
        finally:
            task.cancel()
            await asyncio.wait([task])
            peer.close()
