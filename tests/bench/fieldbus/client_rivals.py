# SPDX-License-Identifier: Apache-2.0
"""Reads four registers with another library as fast as it can; prints a line of JSON at the end.

python client_rivals.py KIND PORT SECONDS HOGS

KIND: pymodbus-async, pymodbus-sync, minimalmodbus
"""

from __future__ import annotations

import asyncio
import json
import resource
import sys
import threading
import time
from collections.abc import Callable

ADDRESS, COUNT, UNIT, BAUDRATE = 16, 4, 1, 115200
REPLY_WITHIN_S = 0.1


def hog() -> None:
    while True:
        sum(range(1000))


def cpu_ns() -> int:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return round((used.ru_utime + used.ru_stime) * 1e9)


def in_turn(read: Callable[[], object], seconds: float) -> dict[str, int]:
    done = errors = 0
    before, end_s = cpu_ns(), time.monotonic() + seconds
    while time.monotonic() < end_s:
        try:
            read()
        except Exception:  # noqa: BLE001  # each of them raises its own
            errors += 1
        done += 1
    return {"transactions": done, "errors": errors, "cpu_ns": cpu_ns() - before}


def minimalmodbus(port: str, seconds: float) -> dict[str, int]:
    import minimalmodbus as library

    drive = library.Instrument(port, UNIT)
    drive.serial.baudrate = BAUDRATE
    drive.serial.timeout = REPLY_WITHIN_S
    return in_turn(lambda: drive.read_registers(ADDRESS, COUNT), seconds)


def pymodbus_sync(port: str, seconds: float) -> dict[str, int]:
    from pymodbus.client import ModbusSerialClient

    client = ModbusSerialClient(port, baudrate=BAUDRATE, timeout=REPLY_WITHIN_S, retries=0)
    assert client.connect()
    read = client.read_holding_registers
    return in_turn(lambda: read(ADDRESS, count=COUNT, device_id=UNIT), seconds)


async def pymodbus_async(port: str, seconds: float) -> dict[str, int]:
    from pymodbus.client import AsyncModbusSerialClient

    client = AsyncModbusSerialClient(port, baudrate=BAUDRATE, timeout=REPLY_WITHIN_S, retries=0)
    assert await client.connect()
    done = errors = 0
    before, end_s = cpu_ns(), time.monotonic() + seconds
    while time.monotonic() < end_s:
        try:
            await client.read_holding_registers(ADDRESS, count=COUNT, device_id=UNIT)
        except Exception:  # noqa: BLE001  # each of them raises its own
            errors += 1
        done += 1
    return {"transactions": done, "errors": errors, "cpu_ns": cpu_ns() - before}


def main(kind: str, port: str, seconds: float, hogs: int) -> None:
    for _ in range(hogs):
        threading.Thread(target=hog, daemon=True).start()
    if kind == "pymodbus-async":
        found = asyncio.run(pymodbus_async(port, seconds))
    else:
        found = {"pymodbus-sync": pymodbus_sync, "minimalmodbus": minimalmodbus}[kind](
            port, seconds
        )
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))
