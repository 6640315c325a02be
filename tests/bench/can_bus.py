# SPDX-License-Identifier: Apache-2.0
"""CPU per CAN frame, sent or received: the rt line beside python-can, on the same kind of socket.

There is no CAN in every kernel, so a SOCK_SEQPACKET socket stands for the bus: system calls and
frames are SocketCAN's, its driver is not. Four drives speak 500 times a second each, and are told
as often. python-can's side is the least that a cyclic script does: its own packing,
`capture_message` and Message for each frame, all that has come at once a cycle; no limits, no
watching, no stops. motord's is the whole process with the shipped line on it.

python can_bus.py (drives|rt|python-can) PATH SECONDS
"""

from __future__ import annotations

import asyncio
import json
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
FRAME = struct.Struct("=IB3x8s")
GOAL = 0.15
WARM_UP_S = 1.5


def cpu_ns() -> int:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return round((used.ru_utime + used.ru_stime) * 1e9)


# ---------------------------------------------------------------------------------- the other end
def drives(path: str, seconds: float) -> None:
    """Until its time is over, or the line closes the bus."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as door:
        door.bind(path)
        door.listen(1)
        end, _ = door.accept()
        end.settimeout(0.0)
        speak(end, time.monotonic() + seconds)


def speak(end: socket.socket, until_s: float) -> None:
    due_s, turn = time.monotonic(), 0
    while due_s < until_s:
        due_s, turn = due_s + 1 / RATE_HZ, turn + 1
        try:
            for node in NODES:
                estimates = struct.pack("<ff", turn / 100, 1.0)
                end.send(FRAME.pack(node << 5 | ESTIMATES, 8, estimates))
                if turn % (RATE_HZ // 10) == 0:
                    end.send(FRAME.pack(node << 5 | HEARTBEAT, 8, struct.pack("<IB3x", 0, 1)))
            while end.recv(72):
                pass
            return
        except BlockingIOError:
            time.sleep(max(0.0, due_s - time.monotonic()))
        except (BrokenPipeError, ConnectionResetError):
            return


# ---------------------------------------------------------------------------------- the two sides
async def with_rt(path: str, seconds: float) -> dict[str, int]:
    from motord_hal.drives.load import find_profile
    from motord_hal.lines import open_line
    from motord_hal.ports import DriveState, JointSpec, LineSpec
    from motord_hal.rt import Exchange

    profile = find_profile("odrive-0.5")
    joints = tuple(
        JointSpec(index=n, name=f"j{n}", profile=profile, unit=node) for n, node in enumerate(NODES)
    )
    spec = LineSpec(
        index=0, name="bench", kind="can", port=f"unix:{path}", baudrate=1_000_000, parity="none",
        stop_bits=1, cycle_hz=float(RATE_HZ), gap_s=None, engine="rt", joints=joints,
        watchdog_s=0.5,
    )  # fmt: skip
    line = open_line(spec, Exchange.private(), lambda _: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        async with asyncio.timeout(20):
            while set(line.drive_states.values()) != {DriveState.READY}:
                await asyncio.sleep(0.05)
        await asyncio.sleep(WARM_UP_S)

        def now() -> tuple[int, int]:
            report = line._thread.report()  # type: ignore[attr-defined]
            return cpu_ns(), report.received + report.sent

        before = now()
        await asyncio.sleep(seconds)
        after = now()
        running.cancel()
    return {"cpu_ns": after[0] - before[0], "frames": after[1] - before[1]}


def with_python_can(path: str, seconds: float) -> dict[str, int]:
    import can
    from can.interfaces.socketcan.socketcan import build_can_frame, capture_message

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as bus:
        bus.connect(path)
        bus.settimeout(0.0)
        bus.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS, as python-can asks for
        frames, due_s, start = 0, time.monotonic(), (0, 0)
        begin_s = due_s + WARM_UP_S
        while due_s < begin_s + seconds:
            if start == (0, 0) and due_s >= begin_s:
                start = (cpu_ns(), frames)
            for node in NODES:
                told = can.Message(
                    arbitration_id=node << 5 | INPUT_VELOCITY,
                    is_extended_id=False,
                    data=struct.pack("<ff", 0.0, 0.0),
                )
                bus.send(build_can_frame(told))
                frames += 1
            try:
                while message := capture_message(bus):
                    if message.arbitration_id & 0x1F == ESTIMATES:
                        struct.unpack("<ff", message.data)
                    frames += 1
            except (can.CanError, BlockingIOError):
                pass
            due_s += 1 / RATE_HZ
            time.sleep(max(0.0, due_s - time.monotonic()))
        return {"cpu_ns": cpu_ns() - start[0], "frames": frames - start[1]}


# --------------------------------------------------------------------------------------- measuring
def once(side: str, seconds: float) -> float:
    """Microseconds of CPU a frame."""
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
    """By turns, so that a busy minute hurts both."""
    found: dict[str, list[float]] = {"rt": [], "python-can": []}
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
    part = statistics.median(found["rt"]) / statistics.median(found["python-can"])
    text = f"a CAN frame costs {part:.3f} of python-can's CPU (goal: at most {GOAL})"
    return [(text, part <= GOAL, False)]


if __name__ == "__main__":
    which, where, how_long = sys.argv[1], sys.argv[2], float(sys.argv[3])
    if which == "drives":
        drives(where, how_long)
    elif which == "rt":
        print(json.dumps(asyncio.run(with_rt(where, how_long))))
    else:
        print(json.dumps(with_python_can(where, how_long)))
