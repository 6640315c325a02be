# SPDX-License-Identifier: Apache-2.0
"""The register file of a simulated drive: words by address, access rights, ranges, live values.

Refusals are Modbus exceptions (MODBUS Application Protocol V1.1b3, section 7).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from motord_hal.drives.profile import DriveProfile, Register

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
BUSY = 6


class Refusal(Exception):
    """Refusal of a request. The drive answers with this exception code."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def raw_of(register: Register, value: float) -> int:
    """Return the raw value of a physical one as a drive reports it. A value that does not fit is
    clipped, and an unsigned register drops the sign."""
    low, high = register.raw_range
    if register.mask is not None:
        bits = register.mask.bit_count()
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if low else (0, (1 << bits) - 1)
    raw = register.from_si(value if register.type.signed else abs(value))
    return max(low, min(high, raw))


class Registers(Protocol):
    """Interface of the registers for the simulated drive itself."""

    def power_up(self) -> None: ...

    def make_live(self, name: str, value: Callable[[], int]) -> None: ...

    def stored(self, name: str) -> int: ...

    def put(self, name: str, raw: int) -> None: ...


class RegisterFile:
    """The registers of a drive's profile, as words. A live register is computed when it is read."""

    def __init__(self, profile: DriveProfile) -> None:
        self._profile = profile
        self._words: dict[int, int] = {}
        self._live: dict[str, Callable[[], int]] = {}
        self._at: dict[int, list[Register]] = {}
        for register in profile.registers.values():
            for offset in range(register.type.words):
                self._at.setdefault(register.address + offset, []).append(register)
        self.power_up()

    def power_up(self) -> None:
        """Set all registers to their defaults."""
        self._words = dict.fromkeys(self._at, 0)
        for register in self._profile.registers.values():
            self._store(register, register.default)

    def make_live(self, name: str, value: Callable[[], int]) -> None:
        """Make `value` return this register's raw value from now on."""
        self._live[name] = value

    def stored(self, name: str) -> int:
        """Return the raw value written last, or that at power-up, signed like the register."""
        register = self._profile.registers[name]
        words, at = self._words, register.address
        both = (words[at], words[at + 1]) if register.type.words == 2 else (words[at],)
        return register.decode(both)

    def put(self, name: str, raw: int) -> None:
        """Change a register from the drive's side."""
        self._store(self._profile.registers[name], raw)

    def read(self, address: int, count: int) -> tuple[int, ...]:
        """Return the words for a reply. Raises Refusal."""
        self._check_count(count)
        words = {}
        for at in range(address, address + count):
            readable = [register for register in self._at.get(at, ()) if "r" in register.access]
            if not readable:
                raise Refusal(ILLEGAL_ADDRESS, f"{at:#06x} cannot be read")
            words[at] = self._words[at]
            for register in readable:
                words[at] = self._live_word(register, at, words[at])
        return tuple(words.values())

    def _live_word(self, register: Register, at: int, word: int) -> int:
        live = self._live.get(register.name)
        if live is None:
            return word
        raw = live()
        if register.mask is None:
            return register.encode(raw)[at - register.address]
        return word & ~register.mask | raw * (register.mask & -register.mask) & register.mask

    def write(self, address: int, words: tuple[int, ...]) -> list[tuple[str, int]]:
        """Store the words; return the raw values by register, in the order of their addresses. If
        one is refused, nothing is stored. Raises Refusal."""
        self._check_count(len(words))
        values = []
        at = address
        while at < address + len(words):
            register = self._writable(at)
            own = words[at - address : at - address + register.type.words]
            if len(own) != register.type.words:
                raise Refusal(ILLEGAL_VALUE, f"half of {register.name}")
            values.append((register.name, self._in_range(register, register.decode(own))))
            at += register.type.words
        for name, raw in values:
            self.put(name, raw)
        return values

    def _check_count(self, count: int) -> None:
        if not 1 <= count <= self._profile.max_registers:
            raise Refusal(ILLEGAL_VALUE, f"{count} registers in one request")

    def _writable(self, at: int) -> Register:
        for register in self._at.get(at, ()):
            if register.address == at and "w" in register.access:
                return register
        raise Refusal(ILLEGAL_ADDRESS, f"{at:#06x} cannot be written")

    @staticmethod
    def _in_range(register: Register, raw: int) -> int:
        value = raw * register.scale
        low, high = register.minimum, register.maximum
        if (low is not None and value < low) or (high is not None and value > high):
            raise Refusal(ILLEGAL_VALUE, f"{register.name}: {value:g} {register.unit}")
        return raw

    def _store(self, register: Register, raw: int) -> None:
        for offset, word in enumerate(register.encode(raw)):
            self._words[register.address + offset] = word
