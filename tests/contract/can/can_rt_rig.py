# SPDX-License-Identifier: Apache-2.0
"""The C thread of a CAN line on a scripted bus."""

import asyncio
import select
import socket
import struct
import time

import pytest
from can_rig import TURN
from loop_side import until
from scripted_odrive import IDLE, INPUT_VELOCITY, STATE

from motord_hal.fieldbus.ports import DriveState

FRAME = struct.Struct("=IB3x8s")
"""`struct can_frame` of linux/can.h."""

HEARTBEAT, ESTIMATES = 0x01, 0x09


class Bus:
    """A bus with one axis, which is read only when the test calls a method, from any thread."""

    engine = "auto"

    def __init__(self, folder):
        self.address = f"unix:{folder}/bus"
        self.door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.door.bind(f"{folder}/bus")
        self.door.listen(8)
        self.door.settimeout(20.0)
        self.end = None
        self.state = IDLE
        self.reported_ns = 0
        self.received = []

    def accept(self):
        self.end, _ = self.door.accept()
        self.end.settimeout(0.0)

    def close(self):
        self.door.close()
        if self.end is not None:
            self.end.close()

    def say(self):
        """Send what an axis at rest sends periodically: a heartbeat and its estimates."""
        self.reported_ns = time.monotonic_ns()
        for command, data in (
            (HEARTBEAT, struct.pack("<IB3x", 0, self.state)),
            (ESTIMATES, struct.pack("<ff", 0.0, 0.0)),
        ):
            self.end.send(FRAME.pack(command, 8, data))

    def receive(self):
        """Take in all received frames; the axis changes to a requested state at once."""
        while True:
            try:
                frame = self.end.recv(72)
            except BlockingIOError:
                return
            if not frame:
                return  # the line has gone
            identifier, size, data = FRAME.unpack(frame)
            if not identifier & 0x40000000:
                self.received.append((identifier & 0x1F, data[:size]))
            if identifier & 0x1F == STATE:
                self.state = int.from_bytes(data[:4], "little")

    def velocities(self):
        sent = [data for command, data in self.received if command == INPUT_VELOCITY]
        return [struct.unpack("<ff", data)[0] for data in sent]

    def states(self):
        return [int.from_bytes(data[:4], "little") for c, data in self.received if c == STATE]

    def live(self, seconds):
        """Run the axis for this time while the event loop of this process is blocked."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.say()
            self.receive()
            select.select([self.end], [], [], 0.005)


async def lively(rig, bus, condition):
    """Run the axis until the condition is true."""

    def both():
        bus.say()
        bus.receive()
        return condition()

    await until(both)


async def arm(rig, bus):
    await lively(rig, bus, lambda: rig.states() == {DriveState.READY})
    async with asyncio.TaskGroup() as group:
        task = group.create_task(rig.line.arm())
        await lively(rig, bus, task.done)
    rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: TURN}
    await lively(rig, bus, lambda: bus.velocities()[-1] == pytest.approx(1.0))
