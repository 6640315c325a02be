# SPDX-License-Identifier: Apache-2.0
"""Finds the bus servos on a line with pings and reads of the model number. It writes nothing."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Iterable, Iterator

from motord.config.drives.load import list_profiles, load_profile
from motord_hal.base.errors import PortError, ProfileError
from motord_hal.serial.port import OpenPort
from motord_hal.servo.packets import (
    BROADCAST_UNIT,
    Instruction,
    Packet,
    PacketError,
    Packets,
    decode,
    packets_of,
)

BAUDRATES = {
    "feetech": (1_000_000, 500_000, 115_200),
    "dynamixel": (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 4_500_000),
}
"""Kind of servo → baud rates: first the default of the servos, then other usual ones."""
REPLY_WITHIN_S = 0.05
PING_ALL_WITHIN_S = 0.3
"""Time for the answers to a ping of all units: a Dynamixel with a higher unit answers later."""
MODEL_NUMBER = "model_number"
"""Name of the register whose default, in a profile, is the number of the model."""


def received(port: OpenPort) -> bytes:
    """Return the bytes that have come. Raise PortError if the port is lost."""
    try:
        data = os.read(port.fd, 512)
    except BlockingIOError:
        return b""
    except OSError as error:
        raise PortError(f"{port.path}: {error.strerror}") from error
    if not data:
        raise PortError(f"{port.path} has hung up")
    return data


def servo_bound_s(baudrate: int, units: Iterable[int]) -> float:
    """Return the longest time that the pings at this baud rate take."""
    each = len(list(units)) * (REPLY_WITHIN_S + 0.01)
    feetech_s = each if baudrate in BAUDRATES["feetech"] else 0.0
    return feetech_s + (PING_ALL_WITHIN_S if baudrate in BAUDRATES["dynamixel"] else 0.0)


def servos(port: OpenPort, baudrate: int, units: Iterable[int]) -> Iterator[tuple[str, int, str]]:
    """Yield for each servo its kind, its unit and the profile for its model number ("": there is no
    such profile). Raise PortError if the port is lost."""
    wanted = list(units)
    if baudrate in BAUDRATES["dynamixel"]:
        for unit in _ping_all(port, wanted):
            yield "dynamixel", unit, _profile(port, "dynamixel", unit)
    if baudrate in BAUDRATES["feetech"]:
        for unit in wanted:
            if _ask(port, packets_of("feetech"), unit, Instruction.PING, b"") is not None:
                yield "feetech", unit, _profile(port, "feetech", unit)


def _ping_all(port: OpenPort, units: list[int]) -> list[int]:
    packets = packets_of("dynamixel")
    request = packets.build(BROADCAST_UNIT, Instruction.PING)
    statuses = _statuses(port, packets, request, PING_ALL_WITHIN_S)
    return sorted({status.unit for status in statuses if status.unit in units})


def _profile(port: OpenPort, kind: str, unit: int) -> str:
    """Return the first profile of this kind with the servo's model number; "": no such profile."""
    packets = packets_of(kind)
    for name, path in list_profiles().items():
        try:
            profile = load_profile(path)
        except ProfileError:
            continue  # `motord drives` shows the error in it
        register = profile.registers.get(MODEL_NUMBER)
        if profile.protocol != kind or register is None:
            continue
        numbers = packets.number(register.address) + packets.number(2)
        data = _ask(port, packets, unit, Instruction.READ, numbers)
        if data and decode(register, data) == register.default:
            return name
    return ""


def _ask(port: OpenPort, packets: Packets, unit: int, code: int, parameters: bytes) -> bytes | None:
    request = packets.build(unit, code, parameters)
    for status in _statuses(port, packets, request, REPLY_WITHIN_S):
        if status.unit == unit:
            return status.parameters
    return None


def _statuses(
    port: OpenPort, packets: Packets, request: bytes, within_s: float
) -> Iterator[Packet]:
    """Send a request and yield the answers to it. Skip the echo of the request that some adapters
    receive."""
    port.flush()
    os.write(port.fd, request)
    end_s, data, first = time.monotonic() + within_s, b"", True
    while (left_s := end_s - time.monotonic()) > 0:
        if not select.select([port.fd], [], [], left_s)[0]:
            return
        data += received(port)
        if first and request.startswith(data[: len(request)]) and len(data) < len(request):
            continue
        data = data.removeprefix(request) if first else data
        first = False
        while data:
            try:
                packet, done = packets.take(data, status=True)
            except PacketError as error:
                packet, done = None, error.done
            if done == 0:
                break
            data = data[done:]
            if packet is not None:
                yield packet
