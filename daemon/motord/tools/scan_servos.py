# SPDX-License-Identifier: Apache-2.0
"""Which bus servos are on a line: pings, and a read of the model number. Nothing is written."""

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
"""As delivered first; then what is usual."""
REPLY_WITHIN_S = 0.05
PING_ALL_WITHIN_S = 0.3
"""A Dynamixel answers a ping of all later, the higher its unit is."""
MODEL_NUMBER = "model_number"
"""The register of a profile whose default is the model's number."""


def received(port: OpenPort) -> bytes:
    """What has come. Raises PortError."""
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
    """The longest time that the pings at this rate take."""
    each = len(list(units)) * (REPLY_WITHIN_S + 0.01)
    feetech_s = each if baudrate in BAUDRATES["feetech"] else 0.0
    return feetech_s + (PING_ALL_WITHIN_S if baudrate in BAUDRATES["dynamixel"] else 0.0)


def servos(port: OpenPort, baudrate: int, units: Iterable[int]) -> Iterator[tuple[str, int, str]]:
    """Kind, unit and the profile whose model number it has, or "". Raises PortError."""
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
    """The first profile of this kind that names the servo's model."""
    packets = packets_of(kind)
    for name, path in list_profiles().items():
        try:
            profile = load_profile(path)
        except ProfileError:
            continue  # `motord drives` says what is wrong with it
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
    """What is answered, without the copy that an adapter receives of its request."""
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
