# SPDX-License-Identifier: Apache-2.0
"""Bus servos on a pty whose packets are made by their makers' SDKs, so that motord's line is tested
against code that is not motord's.

The SDK builds every received request once more from its content, and the bytes are compared; every
status is packed by the SDK's own packet code."""

from __future__ import annotations

import asyncio
import itertools
import os
import tty
from pathlib import Path

import dynamixel_sdk
import scservo_sdk

TABLE_BYTES = 256
PING, READ, WRITE, REBOOT, STATUS = 1, 2, 3, 8, 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
ALL = 0xFE


class CapturedPort:
    """The port that an SDK's packet code needs; it keeps what is sent."""

    def __init__(self):
        self.is_using = False
        self.sent = b""

    def clearPort(self):  # noqa: N802  # the SDKs' names
        pass

    def setPacketTimeout(self, _):  # noqa: N802
        pass

    def writePort(self, packet):  # noqa: N802
        self.sent += bytes(packet)
        return len(packet)

    def take(self):
        sent, self.sent, self.is_using = self.sent, b"", False
        return sent


class FeetechSdk:
    """The packet code of ftservo-python-sdk."""

    width, goal, present, torque, mode = 1, (46, 2), (58, 2), 40, 33
    model = 3, (777).to_bytes(2, "little")
    """Place and content of the model number."""

    def __init__(self):
        self.port = CapturedPort()
        self.handler = scservo_sdk.sms_sts(self.port)

    def end_of(self, data):
        """Return the length of the first packet, 0 while it is incomplete."""
        return 4 + data[3] if len(data) > 3 and len(data) >= 4 + data[3] else 0

    def parts(self, packet):
        return packet[2], packet[4], packet[5:-1]

    def status(self, unit, data):
        """Return a status packet as the SDK packs it."""
        self.handler.txPacket([0, 0, unit, len(data) + 2, 0, *data, 0])
        return self.port.take()

    def rebuilt(self, unit, code, parameters):
        """Return the packet that the SDK sends for the same request."""
        handler, first = self.handler, parameters[0] if parameters else 0
        match code:
            case 1:
                handler.txPacket([0, 0, unit, 2, PING, 0])
            case 2:
                handler.readTx(unit, first, parameters[1])
            case 3:
                handler.writeTxOnly(unit, first, len(parameters) - 1, list(parameters[1:]))
            case 0x82:
                handler.syncReadTx(first, parameters[1], list(parameters[2:]), len(parameters) - 2)
            case 0x83:
                rows = list(parameters[2:])
                handler.syncWriteTxOnly(first, parameters[1], rows, len(rows))
        return self.port.take()


class ScsSdk(FeetechSdk):
    """The packet code of ftservo-python-sdk's class for the SCS series."""

    goal, present = (42, 2), (56, 2)
    model = 3, (1284).to_bytes(2, "big")

    def __init__(self):
        super().__init__()
        self.handler = scservo_sdk.scscl(self.port)


class DynamixelSdk:
    """The packet code of dynamixel-sdk."""

    width, goal, present, torque, mode = 2, (104, 4), (128, 4), 64, 11
    model = 0, (1060).to_bytes(2, "little")

    def __init__(self):
        self.port = CapturedPort()
        self.handler = dynamixel_sdk.PacketHandler(2.0)

    def end_of(self, data):
        end = 7 + int.from_bytes(data[5:7], "little") if len(data) > 6 else 0
        return end if 0 < end <= len(data) else 0

    def parts(self, packet):
        plain = self.handler.removeStuffing(list(packet))
        end = 7 + (plain[5] | plain[6] << 8)
        return plain[4], plain[7], bytes(plain[8 : end - 2])

    def status(self, unit, data):
        length = len(data) + 4
        head = [0, 0, 0, 0, unit, length & 0xFF, length >> 8, STATUS, 0]
        self.handler.txPacket(self.port, [*head, *data, 0, 0])
        return self.port.take()

    def status_of_all(self, asked, answers):
        """Return one status packet with unit and data of each answer, for `asked` requested units.
        The SDK computes its check sums."""
        length = 1 + asked * (len(answers[0][1]) + 4) if answers else 0
        packet = [0xFF, 0xFF, 0xFD, 0, ALL, length & 0xFF, length >> 8, STATUS] if answers else []
        for unit, data in answers:
            packet += [0, unit, *data]
            crc = self.handler.updateCRC(0, packet, len(packet))
            packet += [crc & 0xFF, crc >> 8]
        return bytes(packet)

    def rebuilt(self, unit, code, parameters):
        handler, port = self.handler, self.port
        first, count = (int.from_bytes(parameters[at : at + 2], "little") for at in (0, 2))
        match code:
            case 1 | 8:
                handler.txPacket(port, [0, 0, 0, 0, unit, 3, 0, code, 0, 0])
            case 2:
                handler.readTx(port, unit, first, count)
            case 3:
                data = list(parameters[2:])
                handler.writeTxOnly(port, unit, first, len(data), data)
            case 0x82 | 0x8A:
                units = list(parameters[4:])
                handler.syncReadTx(port, first, count, units, len(units), code == FAST_SYNC_READ)
            case 0x83:
                rows = list(parameters[4:])
                handler.syncWriteTxOnly(port, first, count, rows, len(rows))
        return port.take()


class SdkServos:
    """Servos of one maker on `path`, served by the running event loop. A wheel has its commanded
    speed at once."""

    def __init__(self, path: Path, sdk, units):
        self.sdk = sdk
        self.tables = {unit: bytearray(TABLE_BYTES) for unit in units}
        first, number = sdk.model
        for table in self.tables.values():
            table[first : first + len(number)] = number
        self.codes: list[int] = []
        self.silent: set[int] = set()
        """Units that receive requests and follow them, but do not answer."""
        self.foreign: list[bytes] = []
        """Received requests whose bytes differ from those of the SDK."""
        self.powered_in_other_modes = 0
        self._data = b""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        path.symlink_to(os.ttyname(self._slave))
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def close(self):
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)

    def goal(self, unit):
        address, size = self.sdk.goal
        return int.from_bytes(self.tables[unit][address : address + size], "little")

    def _readable(self):
        try:
            self._data += os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return
        while end := self.sdk.end_of(self._data):
            packet, self._data = self._data[:end], self._data[end:]
            self._obey(packet)

    def _obey(self, packet):
        unit, code, parameters = self.sdk.parts(packet)
        self.codes.append(code)
        if self.sdk.rebuilt(unit, code, parameters) != packet:
            self.foreign.append(packet)
        width = self.sdk.width
        first = int.from_bytes(parameters[:width], "little")
        count = int.from_bytes(parameters[width : 2 * width], "little")
        if code == READ:
            self._answer(unit, self.tables[unit][first : first + count])
        elif code == WRITE:
            for each in self.tables if unit == ALL else [unit]:
                self._write(each, first, parameters[width:])
            if unit != ALL:
                self._answer(unit, b"")
        elif code == SYNC_WRITE:
            rows = parameters[2 * width :]
            for at in range(0, len(rows), count + 1):
                self._write(rows[at], first, rows[at + 1 : at + 1 + count])
        elif code == SYNC_READ:
            for each in parameters[2 * width :]:
                self._answer(each, self.tables[each][first : first + count])
        elif code == FAST_SYNC_READ:
            self._answer_together(parameters[2 * width :], first, count)

    def _write(self, unit, first, data):
        table, sdk = self.tables[unit], self.sdk
        table[first : first + len(data)] = data
        goal, size = sdk.goal
        moving = table[goal : goal + size] if table[sdk.torque] else bytes(size)
        table[sdk.present[0] : sdk.present[0] + size] = moving
        self.powered_in_other_modes += bool(table[sdk.torque] and table[sdk.mode] != 1)

    def _answer_together(self, units, first, count):
        """Answer for the units before the first silent one: those after it would wait for it."""
        there = list(itertools.takewhile(lambda unit: unit not in self.silent, units))
        answers = [(unit, self.tables[unit][first : first + count]) for unit in there]
        os.write(self._master, self.sdk.status_of_all(len(units), answers))

    def _answer(self, unit, data):
        if unit in self.tables and unit not in self.silent:
            os.write(self._master, self.sdk.status(unit, bytes(data)))
