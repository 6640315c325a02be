# SPDX-License-Identifier: Apache-2.0
"""A master of bus servos, as fast as it can: prints "ready", and goes on until stdin ends.

python client_servos.py motord|sdk feetech|dynamixel PORT BAUDRATE SERVOS HOGS
"""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from collections.abc import Callable

from motord.config.drives.load import find_profile
from motord_hal.base.clock import now_ns
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import DriveState, Echo, JointSpec, LineSpec
from motord_hal.realtime.exchange import Exchange, JointSetpoint, Setpoints

PROFILES = {"feetech": "sts3215", "dynamixel": "xl430"}
AS_FAST_AS_IT_WILL_HZ = 20_000.0
KEPT_S = 90.0
"""Age that set-points may reach: they are put only when the measurement begins."""


def hog() -> None:
    while True:
        sum(range(1000))


def begin_hogs(hogs: int) -> None:
    for _ in range(hogs):
        threading.Thread(target=hog, daemon=True).start()


async def motord(kind: str, port: str, baudrate: int, servos: int, hogs: int) -> None:
    profile = find_profile(PROFILES[kind])
    joints = tuple(
        JointSpec(index=n, name=f"wheel{n}", profile=profile, unit=n + 1) for n in range(servos)
    )
    spec = LineSpec(
        index=0, name="bench", kind=kind, port=port, baudrate=baudrate, parity="none", stop_bits=1,
        cycle_hz=AS_FAST_AS_IT_WILL_HZ, gap_s=None, engine="rt", joints=joints, watchdog_s=2.0,
        setpoint_timeout_s=KEPT_S, echo=Echo.NO,
    )  # fmt: skip
    exchange = Exchange.private()
    wheels = tuple(JointSetpoint(0.5, 0.0) for _ in range(servos))
    exchange.put_setpoints(0, Setpoints(now_ns(), 1, enabled=False, joints=wheels))
    line = open_line(spec, exchange, lambda _: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        async with asyncio.timeout(20):
            while set(line.drive_states.values()) != {DriveState.READY}:
                await asyncio.sleep(0.05)
        await line.arm()
        exchange.put_setpoints(0, Setpoints(now_ns(), 1, enabled=True, joints=wheels))
        begin_hogs(hogs)
        print("ready", flush=True)
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
        if set(line.drive_states.values()) != {DriveState.ARMED}:
            print(line.stats().errors, file=sys.stderr)
        running.cancel()


def feetech(port: str, baudrate: int, servos: int) -> Callable[[], object]:
    import scservo_sdk as sdk

    handler = sdk.PortHandler(port)
    assert handler.setBaudRate(baudrate)
    servo = sdk.sms_sts(handler)
    write, read = sdk.GroupSyncWrite(servo, 46, 2), sdk.GroupSyncRead(servo, 56, 15)
    for unit in range(1, servos + 1):
        write.addParam(unit, [100, 0])
        read.addParam(unit)

    def cycle() -> None:
        for unit in range(1, servos + 1):
            write.changeParam(unit, [100, 0])
        write.txPacket()
        read.txRxPacket()

    return cycle


def dynamixel(port: str, baudrate: int, servos: int) -> Callable[[], object]:
    import dynamixel_sdk as sdk

    handler = sdk.PortHandler(port)
    assert handler.setBaudRate(baudrate)
    packets = sdk.PacketHandler(2.0)
    write = sdk.GroupSyncWrite(handler, packets, 104, 4)
    read = sdk.GroupSyncRead(handler, packets, 128, 8)
    for unit in range(1, servos + 1):
        write.addParam(unit, [20, 0, 0, 0])
        read.addParam(unit)

    def cycle() -> None:
        for unit in range(1, servos + 1):
            write.changeParam(unit, [20, 0, 0, 0])
        write.txPacket()
        read.txRxPacket()

    return cycle


def makers(kind: str, port: str, baudrate: int, servos: int, hogs: int) -> None:
    cycle = {"feetech": feetech, "dynamixel": dynamixel}[kind](port, baudrate, servos)
    begin_hogs(hogs)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ended.set()), daemon=True).start()
    print("ready", flush=True)
    while not ended.is_set():
        cycle()
    os._exit(0)  # the hogs end with it


if __name__ == "__main__":
    who, kind, port = sys.argv[1:4]
    numbers = [int(word) for word in sys.argv[4:7]]
    if who == "motord":
        asyncio.run(motord(kind, port, *numbers))
    else:
        makers(kind, port, *numbers)
