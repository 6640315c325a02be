# SPDX-License-Identifier: Apache-2.0
"""Contents of simulated drives: registers by name alone; DDSM frames, in which a name is a place in
a command's request or reply (motord_hal.ddsm.codec); the control table of a bus servo."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord_hal.ddsm.codec import byte_of, command_of, pick, place, seal, size_bytes
from motord_hal.drives.profile import DriveProfile, Register
from motord_hal.servo import packets as servo

FRAME_CONTENT_BYTES = 8
TABLE_BYTES = 256


class NamedContent:
    """Registers of a drive's profile, by name. A live register is computed when it is read."""

    def __init__(self, profile: DriveProfile) -> None:
        self._registers = profile.registers
        self._raw: dict[str, int] = {}
        self._live: dict[str, Callable[[], int]] = {}
        self.power_up()

    def power_up(self) -> None:
        """Set all registers to their defaults."""
        self._raw = {name: register.default for name, register in self._registers.items()}

    def make_live(self, name: str, value: Callable[[], int]) -> None:
        self._live[name] = value

    def stored(self, name: str) -> int:
        return self._raw[name]

    def put(self, name: str, raw: int) -> None:
        self._raw[name] = raw

    def value(self, name: str) -> int:
        """Return the raw value that the drive reports now."""
        live = self._live.get(name)
        return self._raw[name] if live is None else live()


class FrameContent(NamedContent):
    """Registers of a DDSM motor."""

    def write(self, frame: bytes) -> list[tuple[str, int]]:
        """Store the values of a request, and return them. A value out of range changes nothing."""
        written = []
        for name, register in self._registers.items():
            if command_of(register) != frame[1] or "w" not in register.access:
                continue
            raw = pick(frame, register)
            if _in_range(register, raw):
                self.put(name, raw)
                written.append((name, raw))
        return written

    def reply(self, unit: int, command: int) -> bytes | None:
        """Return the drive's answer to a command; None: the command is unknown."""
        sent = [
            register
            for register in self._registers.values()
            if command_of(register) == command and "r" in register.access
        ]
        if not sent:
            return None
        frame = bytearray((unit, command, *bytes(FRAME_CONTENT_BYTES)))
        for register in sent:
            _put(frame, register, self.value(register.name))
        return seal(bytes(frame))


class ControlTable(NamedContent):
    """Bytes by address: the profile's registers, and memory elsewhere."""

    def __init__(self, profile: DriveProfile) -> None:
        super().__init__(profile)
        self.places = sorted(
            (r for r in profile.registers.values() if r.address < TABLE_BYTES),
            key=lambda r: r.address,
        )
        self._memory = bytearray(TABLE_BYTES)

    def read(self, address: int, count: int) -> bytes:
        """Return `count` bytes from an address on."""
        data = bytearray(self._memory[address : address + count].ljust(count, b"\0"))
        for register in self._within(address, count):
            place = register.address - address
            value = servo.encode(register, self.value(register.name))
            for offset, byte in enumerate(value):
                if 0 <= place + offset < count:
                    data[place + offset] = byte
        return bytes(data)

    def write(self, address: int, data: bytes) -> list[tuple[str, int]]:
        """Store bytes, and return the raw values by register."""
        self._memory[address : address + len(data)] = data
        written = []
        for register in self._within(address, len(data)):
            place = register.address - address
            whole = place >= 0 and place + servo.size_bytes(register) <= len(data)
            if whole and "w" in register.access:
                written.append((register.name, servo.decode(register, data[place:])))
        for name, raw in written:
            self.put(name, raw)
        return written

    def _within(self, address: int, count: int) -> Iterator[Register]:
        for register in self.places:
            if register.address < address + count and address < register.address + servo.size_bytes(
                register
            ):
                yield register


def _in_range(register: Register, raw: int) -> bool:
    value = raw * register.scale
    low, high = register.minimum, register.maximum
    return (low is None or value >= low) and (high is None or value <= high)


def _put(frame: bytearray, register: Register, raw: int) -> None:
    if register.mask is None:
        place(frame, register, raw)
        return
    begin, size = byte_of(register), size_bytes(register)
    word = int.from_bytes(frame[begin : begin + size], "big") & ~register.mask
    word |= raw * (register.mask & -register.mask) & register.mask
    frame[begin : begin + size] = word.to_bytes(size, "big")
