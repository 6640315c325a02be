# SPDX-License-Identifier: Apache-2.0
"""Sabertooth packet serial from the driver's side, for the simulator. The line builds its own
packets in csrc/fieldbus/board/board_packets.c.

Source: Dimension Engineering, Sabertooth 2x12 and 2x25 user's guides, mode 4 (packetized serial):
address, command, value, and the low seven bits of their sum. A Sabertooth sends nothing. Commands 0
and 1 drive motor 1 forward and backward, 4 and 5 motor 2; 14 is the serial time-out in units of
0.1 s, off by default, and lost with the driver's power.

In a drive profile with `protocol = "sabertooth"` a register's address is 0 for the time-out, 1 for
motor 1 and 2 for motor 2; a motor's value has a sign.
"""

from __future__ import annotations

from collections.abc import Iterator

from motord_hal.drives.profile import DriveProfile

PACKET_BYTES = 4
CYCLE_BYTES = 3 * PACKET_BYTES
"""Bytes of one cycle: the time-out and two motors."""
UNITS = range(128, 136)
TIMEOUT_AT = 0
ADDRESSES = 3
_TIMEOUT = 14
_MOTOR_COMMANDS = {1: (0, 1), 2: (4, 5)}
"""Address → commands forward and backward."""
_BY_COMMAND = {
    number: (address, sign)
    for address, pair in _MOTOR_COMMANDS.items()
    for number, sign in zip(pair, (1, -1), strict=True)
}


def packet(unit: int, number: int, value: int) -> bytes:
    body = bytes((unit, number, value))
    return body + bytes((sum(body) & 0x7F,))


class Receiver:
    """Receiver of packets from a stream, like a driver at one address."""

    def __init__(self, profile: DriveProfile, unit: int) -> None:
        self._names = {each.address: each.name for each in profile.registers.values()}
        self._unit = unit
        self._tail = b""

    def feed(self, data: bytes) -> Iterator[dict[str, int] | None]:
        """Yield register → raw value of each packet for this unit; None: no packet, or a wrong
        check sum. Only an address is above 127, so such a byte always begins a packet."""
        for byte in data:
            if byte > 0x7F:
                if self._tail:
                    yield None
                self._tail = bytes((byte,))
            elif self._tail:
                self._tail += bytes((byte,))
            if len(self._tail) == PACKET_BYTES:
                whole, self._tail = self._tail, b""
                if whole[0] == self._unit:
                    yield self._read(whole)

    def _read(self, whole: bytes) -> dict[str, int] | None:
        number, value = whole[1], whole[2]
        if whole != packet(self._unit, number, value):
            return None
        if number == _TIMEOUT:
            return {self._names[TIMEOUT_AT]: value}
        if number not in _BY_COMMAND:
            return {}
        address, sign = _BY_COMMAND[number]
        return {self._names[address]: sign * value}
