# SPDX-License-Identifier: Apache-2.0
"""CPU per CAN frame, sent or received: the rt line beside python-can, on the same kind of socket.

Not every kernel has CAN, so a SOCK_SEQPACKET socket stands for the bus: system calls and frames are
SocketCAN's, its driver is not. Each of four drives sends 500 frames a second and receives as many:
each side decodes them, and sends a speed (zero: no drive is armed). Each side is a whole process;
the drives count the frames alike for all.

rt          motord's line in C
asyncio     the same line on python-can: the same profile, watching and stops
python-can  a typical program on python-can: its SocketCAN bus (all but the opening of the socket),
            a Notifier in asyncio's event loop with one listener, a task that sends
script      the smallest program: packing and messages are python-can's, the bus is not; frames
            are read once a cycle

The last two have no watchdog and no stop.

python can_bus.py (drives|rt|asyncio|python-can|script) PATH SECONDS
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import mmap
import resource
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

RATE_HZ = 500
NODES = (0, 3, 5, 7)
HEARTBEAT, ESTIMATES, INPUT_VELOCITY = 0x01, 0x09, 0x0D
SO_TIMESTAMPNS = 35
"""Value in asm-generic/socket.h."""
FRAME = struct.Struct("=IB3x8s")
COUNTER = struct.Struct("=Q")
GOAL = 0.15
WARM_UP_S = 1.5
SIDES = ("rt", "asyncio", "python-can", "script")


def cpu_ns() -> int:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return round((used.ru_utime + used.ru_stime) * 1e9)


class Frames:
    """Number of frames sent and received on the bus, shared with the measuring process."""

    def __init__(self, path: str) -> None:
        file = Path(f"{path}.frames")
        if not file.exists():
            file.write_bytes(bytes(COUNTER.size))
        with file.open("r+b") as opened:
            self._map = mmap.mmap(opened.fileno(), COUNTER.size)

    def say(self, count: int) -> None:
        COUNTER.pack_into(self._map, 0, count)

    def now(self) -> int:
        return int(COUNTER.unpack_from(self._map)[0])


class Meter:
    """CPU of this process and frames on the bus, from the creation of this object to `found`."""

    def __init__(self, path: str) -> None:
        self._frames = Frames(path)
        self._cpu_ns, self._count = cpu_ns(), self._frames.now()

    def found(self) -> dict[str, int]:
        return {"cpu_ns": cpu_ns() - self._cpu_ns, "frames": self._frames.now() - self._count}


# ---------------------------------------------------------------------------------- the other end
def drives(path: str, seconds: float) -> None:
    """Run the drives for this time, or until the line closes the bus."""
    frames = Frames(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as door:
        door.bind(path)
        door.listen(1)
        end, _ = door.accept()
        end.settimeout(0.0)
        speak(end, time.monotonic() + seconds, frames)


def speak(end: socket.socket, until_s: float, frames: Frames) -> None:
    due_s, turn, count = time.monotonic(), 0, 0
    while due_s < until_s:
        due_s, turn = due_s + 1 / RATE_HZ, turn + 1
        try:
            for node in NODES:
                estimates = struct.pack("<ff", turn / 100, 1.0)
                count += end.send(FRAME.pack(node << 5 | ESTIMATES, 8, estimates)) > 0
                if turn % (RATE_HZ // 10) == 0:
                    heartbeat = struct.pack("<IB3x", 0, 1)
                    count += end.send(FRAME.pack(node << 5 | HEARTBEAT, 8, heartbeat)) > 0
            while end.recv(72):
                count += 1
            return
        except BlockingIOError:
            frames.say(count)
            time.sleep(max(0.0, due_s - time.monotonic()))
        except (BrokenPipeError, ConnectionResetError):
            return


# --------------------------------------------------------------------------------------- the sides
async def with_line(engine: str, path: str, seconds: float) -> dict[str, int]:
    """Measure motord's line, set up and at rest."""
    from motord.config.drives.load import find_profile
    from motord_hal.fieldbus.open_line import open_line
    from motord_hal.fieldbus.ports import DriveState, JointSpec, LineSpec
    from motord_hal.realtime.exchange import Exchange

    profile = find_profile("odrive-0.5")
    joints = tuple(
        JointSpec(index=n, name=f"j{n}", profile=profile, unit=node) for n, node in enumerate(NODES)
    )
    spec = LineSpec(
        index=0, name="bench", kind="can", port=f"unix:{path}", baudrate=1_000_000, parity="none",
        stop_bits=1, cycle_hz=float(RATE_HZ), gap_s=None, engine=engine, joints=joints,
        watchdog_s=0.5,
    )  # fmt: skip
    line = open_line(spec, Exchange.private(), lambda _: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        async with asyncio.timeout(20):
            while set(line.drive_states.values()) != {DriveState.READY}:
                await asyncio.sleep(0.05)
        await asyncio.sleep(WARM_UP_S)
        meter = Meter(path)
        await asyncio.sleep(seconds)
        found = meter.found()
        assert set(line.drive_states.values()) == {DriveState.READY}
        running.cancel()
    return found


def python_can_bus(path: str) -> Any:
    """Return python-can's SocketCAN bus, changed only in the opening of its socket."""
    import can
    from can.interfaces.socketcan import SocketcanBus

    class BusOnPath(SocketcanBus):  # type: ignore[misc]
        def __init__(self) -> None:
            self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self.socket.connect(path)
            self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self.channel, self.channel_info = path, path
            self._bcm_sockets: dict[str, socket.socket] = {}
            can.BusABC.__init__(self, path)

        def _apply_filters(self, filters: object) -> None:
            self._is_filtered = True  # on a real bus the kernel does this

    return BusOnPath()


async def with_python_can(path: str, seconds: float) -> dict[str, int]:
    """Measure a Notifier in the event loop, a listener that reads all frames, a task that sends."""
    import can

    bus = python_can_bus(path)
    feedback: dict[int, tuple[float, float]] = {}
    states: dict[int, tuple[int, int]] = {}

    def listener(message: can.Message) -> None:
        node, kind = message.arbitration_id >> 5, message.arbitration_id & 0x1F
        if kind == ESTIMATES:
            feedback[node] = struct.unpack("<ff", message.data)
        elif kind == HEARTBEAT:
            states[node] = struct.unpack("<IB3x", message.data)

    async def command() -> None:
        due_s = time.monotonic()
        while True:
            for node in NODES:
                sent = can.Message(
                    arbitration_id=node << 5 | INPUT_VELOCITY,
                    is_extended_id=False,
                    data=struct.pack("<ff", 0.0, 0.0),
                )
                with contextlib.suppress(can.CanError):  # a full queue: the next one is newer
                    bus.send(sent)
            due_s = max(due_s + 1 / RATE_HZ, time.monotonic())
            await asyncio.sleep(due_s - time.monotonic())

    notifier = can.Notifier(bus, [listener], loop=asyncio.get_running_loop())
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(command())
        await asyncio.sleep(WARM_UP_S)
        meter = Meter(path)
        await asyncio.sleep(seconds)
        found = meter.found()
        running.cancel()
    notifier.stop()
    bus.shutdown()
    assert set(feedback) == set(states) == set(NODES)
    return found


def with_a_script(path: str, seconds: float) -> dict[str, int]:
    """Measure the smallest script: python-can's packing and messages, but not its bus."""
    import can
    from can.interfaces.socketcan.socketcan import build_can_frame, capture_message

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as bus:
        bus.connect(path)
        bus.settimeout(0.0)
        bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        due_s, meter = time.monotonic(), Meter(path)
        begin_s = due_s + WARM_UP_S
        begun = False
        while due_s < begin_s + seconds:
            if not begun and due_s >= begin_s:
                begun, meter = True, Meter(path)
            for node in NODES:
                sent = can.Message(
                    arbitration_id=node << 5 | INPUT_VELOCITY,
                    is_extended_id=False,
                    data=struct.pack("<ff", 0.0, 0.0),
                )
                with contextlib.suppress(BlockingIOError):
                    bus.send(build_can_frame(sent))
            try:
                while message := capture_message(bus):
                    if message.arbitration_id & 0x1F == ESTIMATES:
                        struct.unpack("<ff", message.data)
            except (can.CanError, BlockingIOError):
                pass
            due_s += 1 / RATE_HZ
            time.sleep(max(0.0, due_s - time.monotonic()))
        return meter.found()


# --------------------------------------------------------------------------------------- measuring
def once(side: str, seconds: float) -> float:
    """Return the CPU time of a side in microseconds a frame."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "bus")
        here = [sys.executable, __file__]
        other = subprocess.Popen([*here, "drives", path, str(seconds + 20)])
        try:
            while not Path(path).exists():
                time.sleep(0.01)
            run = subprocess.run(
                [*here, side, path, str(seconds)], capture_output=True, text=True, check=True
            )
        finally:
            other.terminate()
            other.wait()
    found: dict[str, Any] = json.loads(run.stdout)
    return float(found["cpu_ns"] / found["frames"] / 1e3)


def measure(rounds: int, seconds: float) -> dict[str, list[float]]:
    """Return the CPU a frame of each side and round; they take turns: a busy minute affects all."""
    found: dict[str, list[float]] = {side: [] for side in SIDES}
    for _ in range(rounds):
        for side, values in found.items():
            values.append(once(side, seconds))
    return found


def table(found: dict[str, list[float]]) -> str:
    head = "CPU a CAN frame, sent or received, in µs (a socket pair stands for the bus):"
    rows = [
        f"{side:11} " + "  ".join(f"{value:6.2f}" for value in values)
        for side, values in found.items()
    ]
    return "\n".join([head, *rows])


def verdicts(found: dict[str, list[float]]) -> list[tuple[str, bool, bool]]:
    middle = {side: statistics.median(values) for side, values in found.items()}
    whole, program, least = (middle["rt"] / middle[side] for side in SIDES[1:])
    goal = f"goal: at most {GOAL}"
    same = f"a CAN frame costs {whole:.3f} of the asyncio engine's CPU on python-can ({goal})"
    other = (
        f"a CAN frame costs {program:.3f} of the CPU of a program on python-can without"
        f" watchdog and stop ({goal}), {least:.3f} of the least script's"
    )
    return [(same, whole <= GOAL, False), (other, program <= GOAL, False)]


if __name__ == "__main__":
    which, where, how_long = sys.argv[1], sys.argv[2], float(sys.argv[3])
    if which == "drives":
        drives(where, how_long)
    elif which in ("rt", "asyncio"):
        print(json.dumps(asyncio.run(with_line(which, where, how_long))))
    elif which == "python-can":
        print(json.dumps(asyncio.run(with_python_can(where, how_long))))
    else:
        print(json.dumps(with_a_script(where, how_long)))
