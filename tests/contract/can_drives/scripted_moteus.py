# SPDX-License-Identifier: Apache-2.0
"""A moteus controller written from its maker's documents (docs/protocol/can.md, registers.md) and
not from motord's profile: a register server that takes any subframes, in any order."""

import math
import struct
import threading
import time

import can
from shared_bus import end_of

STOPPED, FAULT, ENABLING, POSITION, TIMEOUT, ZERO_VELOCITY = 0, 1, 2, 10, 11, 12
ENABLING_S = 0.02
FORMATS = {0: "<b", 1: "<h", 2: "<i", 3: "<f"}
CURRENT, TORQUE, VOLTAGE = (1, 0.1, 0.001), (0.5, 0.01, 0.001), (0.5, 0.1, 0.001)
CELSIUS, TURNS, TURNS_S = (1, 0.1, 0.001), (0.01, 0.0001, 0.00001), (0.1, 0.00025, 0.00001)
SECONDS, WHOLE = (0.01, 0.001, 0.000001), (1, 1, 1)
# register → value of one count as int8, int16, int32; a float is not scaled
SCALES = {
    0x000: WHOLE, 0x001: TURNS, 0x002: TURNS_S, 0x003: TORQUE, 0x004: CURRENT, 0x00D: VOLTAGE,
    0x00C: WHOLE, 0x00E: CELSIUS, 0x00F: WHOLE, 0x020: TURNS, 0x021: TURNS_S, 0x022: TORQUE,
    0x027: SECONDS, 0x028: TURNS_S, 0x102: WHOLE,
}  # fmt: skip
AT_POWER_UP = {0x00D: 24.0, 0x00E: 31.5, 0x102: 5}
COMMANDS = (0x020, 0x021, 0x022, 0x027, 0x028)
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
NOTHING = 0x50
STOP = bytes([0x01, 0x00, STOPPED])
"""First bytes of a command that takes the power: it writes the mode as int8."""


def varuint(data):
    """Take a whole number from the front of `data`: seven bits a byte, the lowest first."""
    value = shift = 0
    while True:
        byte = data.pop(0)
        value |= (byte & 0x7F) << shift
        shift += 7
        if not byte & 0x80:
            return value


def put_varuint(value):
    low, high = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + put_varuint(high) if high else bytes([low])


class Moteus:
    """One controller on a bus, whose motor has the commanded speed at once."""

    def __init__(self, address, node):
        self.node = node
        self.values = dict.fromkeys(SCALES, 0.0) | AT_POWER_UP
        self.modes, self.velocities, self.bad = [], [], []
        self.positions = []
        """Target of each command, and the controller's mode after it."""
        self.bites = 0
        self.lost_stops = 0
        """Number of the next stop commands that are lost."""
        self.unreceptive = False
        self._fed_s = None
        self._enabled_at_s = 0.0
        self._bus = end_of(address, 1_000_000, 5_000_000)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self):
        self._stopped.set()
        self._thread.join()
        self._bus.shutdown()

    @property
    def mode(self):
        return self.values[0x000]

    def fail(self, code):
        self.values |= {0x000: FAULT, 0x00F: code, 0x002: 0.0}

    def reboot(self):
        self.values |= dict.fromkeys(SCALES, 0.0) | AT_POWER_UP
        self._fed_s = None

    def _serve(self):
        while not self._stopped.is_set():
            message = self._bus.recv(timeout=0.005)
            self._watch()
            mine = message is not None and message.arbitration_id & 0xFF == self.node
            if mine and message.arbitration_id >> 8 & 0x80 and not self.unreceptive:
                if self.lost_stops and message.data.startswith(STOP):
                    self.lost_stops -= 1
                else:
                    self._answer(message)

    def _watch(self):
        if self.mode == ENABLING and time.monotonic() > self._enabled_at_s:
            self.values[0x000] = POSITION
        limit_s = self.values[0x027]
        fed = self._fed_s is not None and self.mode == POSITION and limit_s > 0
        if fed and time.monotonic() - self._fed_s > limit_s:
            self.values |= {0x000: TIMEOUT, 0x002: 0.0}
            self.bites += 1

    def _answer(self, message):
        if not (message.is_fd and message.bitrate_switch and message.is_extended_id):
            self.bad.append(message)
            return
        reply = self.execute(bytes(message.data))
        reply += bytes([NOTHING]) * (min(n for n in LENGTHS if n >= len(reply)) - len(reply))
        identifier = self.node << 8 | message.arbitration_id >> 8 & 0x7F
        extended = identifier >= 0x800
        self._bus.send(can.Message(arbitration_id=identifier, is_extended_id=extended, is_fd=True,
                                   bitrate_switch=True, data=reply))  # fmt: skip

    def execute(self, frame):
        """Carry out the writes of a frame; return the answer to its reads."""
        data, reply = list(frame), b""
        wanted = {}
        while data:
            kind = data.pop(0)
            if kind == NOTHING:
                continue
            action, width = kind & 0xF0, kind >> 2 & 3
            count = kind & 3 or varuint(data)
            first = varuint(data)
            registers = range(first, first + count)
            if action == 0x10:
                self._obey(wanted)
                wanted = {}
                reply += self._sent(width, registers)
                continue
            assert action == 0x00, hex(kind)
            for register in registers:
                size = struct.calcsize(FORMATS[width])
                raw = struct.unpack(FORMATS[width], bytes(data[:size]))[0]
                del data[:size]
                wanted[register] = raw if width == 3 else raw * SCALES[register][width]
        self._obey(wanted)
        return reply

    def _sent(self, width, registers):
        reply = bytes([0x20 | width << 2 | (len(registers) if len(registers) < 4 else 0)])
        reply += bytes([len(registers)]) * (len(registers) >= 4) + put_varuint(registers[0])
        for register in registers:
            value = self.values[register]
            raw = value if width == 3 else round(value / SCALES[register][width])
            reply += struct.pack(FORMATS[width], raw)
        return reply

    def _obey(self, wanted):
        if 0x000 not in wanted:
            assert not wanted, "the mode must be written before anything else"
            return
        mode = wanted[0x000]
        self.modes.append(mode)
        self.values |= dict.fromkeys(COMMANDS, 0.0) | wanted | {0x000: self.mode}
        self._fed_s = time.monotonic()
        if mode == STOPPED:
            self.values |= {0x000: STOPPED, 0x00F: 0}
        elif self.mode == STOPPED and mode == POSITION:
            self.values[0x000] = ENABLING
            self._enabled_at_s = time.monotonic() + ENABLING_S
        elif self.mode not in (FAULT, TIMEOUT, ENABLING):
            self.values[0x000] = mode
        turning = self.mode == POSITION
        self.velocities.append(wanted.get(0x021, 0.0) if turning else 0.0)
        self.values[0x002] = self.velocities[-1]
        target = wanted.get(0x020, 0.0)
        self.positions.append((target, self.mode))
        if turning and not math.isnan(target):
            self.values[0x001] = target
