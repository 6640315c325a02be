# SPDX-License-Identifier: Apache-2.0
"""The cyclic table of one drive, built once from its profile: requests that read registers,
requests that write set-points, and their time on the wire. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from motord_hal.drives.profile import DriveProfile, Register, Step
from motord_hal.fieldbus.job import kept_registers
from motord_hal.fieldbus.plan import (
    REST,
    Plan,
    Reading,
    Wanted,
    of_kind,
    present_positions,
)
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.modbus.codec import (
    READ_REGISTERS_MAX,
    READ_WRITE_WRITE_REGISTERS_MAX,
    Function,
    Request,
    build_request,
    reply_bytes,
)

EXTRA_EVERY_CYCLES = 4
"""Interval at which one range of current, voltage, temperature and the like is read."""
_REQUEST_OVERHEAD_BYTES = 13
"""Bytes of a read request (8) and of a reply without its words (5)."""

WireTime = Callable[[int], float]
"""Function from frame length in bytes to seconds on the wire."""


@dataclass(frozen=True, slots=True)
class ReadRange:
    """Adjacent registers that one request reads."""

    address: int
    count: int
    registers: tuple[Register, ...]

    def request(self, unit: int) -> Request:
        return Request(unit, Function.READ_HOLDING, self.address, count=self.count)

    def decode(self, words: tuple[int, ...]) -> dict[str, int]:
        """Return register name → raw value."""
        return {
            register.name: register.decode(
                words[register.address - self.address :][: register.type.words]
            )
            for register in self.registers
        }


@dataclass(frozen=True, slots=True)
class CyclicExchange:
    """One exchange in each cycle."""

    request: Request
    reads: ReadRange | None
    """Registers in its reply; None: the reply has no registers."""


def wanted_registers(
    profile: DriveProfile, joints: Iterable[JointSpec]
) -> tuple[list[Register], list[Register]]:
    """Return the registers that are read in every cycle, and those that may wait."""
    fast, slow = [], [profile.bus_voltage]
    for joint in joints:
        channel = profile.channels[joint.channel]
        fast += [channel.position, channel.velocity, channel.fault]
        slow += [channel.current, channel.temperature]
    slow = [*kept_registers(profile), *slow]
    if profile.homed:
        slow.insert(0, profile.homed.register)
    if profile.enabled:
        slow.insert(0, profile.enabled.register)
    return (
        [profile.registers[name] for name in dict.fromkeys(fast) if name],
        [profile.registers[name] for name in dict.fromkeys(slow) if name],
    )


class DrivePlan(Plan):
    """One unit with one or more joints on its channels."""

    def __init__(self, joints: Iterable[JointSpec], gap_s: float, wire_time_s: WireTime) -> None:
        super().__init__(joints)
        self._gap_s = gap_s
        self._wire_time_s = wire_time_s
        fast, slow = wanted_registers(self.profile, self.joints)
        ranges = self._merge([*fast, *slow])
        names = {register.name for register in fast}
        self.fast = tuple(r for r in ranges if any(x.name in names for x in r.registers))
        self.extra = tuple(r for r in ranges if r not in self.fast)
        directions = (self.channel(joint).direction for joint in self.joints)
        self.rests = {each.register: each.rest for each in directions if each is not None}
        """Direction register → value that means neither direction."""

    def _merge(self, wanted: list[Register]) -> list[ReadRange]:
        """Return as few ranges as possible: registers in a gap are read, too, if that is faster."""
        ranges: list[list[Register]] = []
        for register in sorted(wanted, key=lambda r: r.address):
            if ranges and self._joins(ranges[-1], register):
                ranges[-1].append(register)
            else:
                ranges.append([register])
        return [
            ReadRange(group[0].address, _end(group[-1]) - group[0].address, tuple(group))
            for group in ranges
        ]

    def _joins(self, group: list[Register], register: Register) -> bool:
        hole = range(_end(group[-1]), register.address)
        readable = {
            address
            for known in self.profile.registers.values()
            if "r" in known.access
            for address in range(known.address, _end(known))
        }
        request_s = self._wire_time_s(_REQUEST_OVERHEAD_BYTES) + 2 * self._gap_s
        return (
            all(address in readable for address in hole)
            and _end(register) - group[0].address <= self.profile.max_registers
            and self._wire_time_s(2 * len(hole)) < request_s
        )

    def writes(self, raw: Mapping[str, int]) -> list[Request]:
        """Return the requests that write these registers; function 16 writes adjacent ones
        together."""
        requests: list[Request] = []
        words: list[int] = []
        begin = 0
        for register in sorted((self.profile.registers[n] for n in raw), key=lambda r: r.address):
            new = register.encode(raw[register.name])
            together = self.profile.write_function == 16 and begin + len(words) == register.address
            if words and together and len(words) + len(new) <= self.profile.max_registers:
                words += new
            else:
                requests += self._write(begin, words)
                begin, words = register.address, list(new)
        return requests + self._write(begin, words)

    def _write(self, address: int, words: list[int]) -> list[Request]:
        if not words:
            return []
        if self.profile.write_function == 16 or len(words) > 1:
            return [Request(self.unit, Function.WRITE_MULTIPLE, address, values=tuple(words))]
        return [Request(self.unit, Function.WRITE_SINGLE, address, values=tuple(words))]

    def cyclic(self, raw: Mapping[str, int]) -> list[CyclicExchange]:
        """Return the exchanges of a cycle that writes these set-points, in order. If the drive can
        do that, the first one writes and reads (function 23, V1.1b3, 6.17: the write comes before
        the read)."""
        writes, ranges = self.writes(raw), list(self.fast)
        begin: list[CyclicExchange] = []
        if len(writes) == 1 and ranges and self._read_write_fits(writes[0], ranges[0]):
            write, span = writes.pop(), ranges.pop(0)
            both = Request(
                self.unit,
                Function.READ_WRITE,
                span.address,
                count=span.count,
                write_address=write.address,
                values=write.values,
            )
            begin = [CyclicExchange(both, span)]
        begin += [CyclicExchange(write, None) for write in writes]
        return begin + [CyclicExchange(span.request(self.unit), span) for span in ranges]

    def _read_write_fits(self, write: Request, span: ReadRange) -> bool:
        most = self.profile.max_registers
        return (
            self.profile.read_write_function == Function.READ_WRITE
            and span.count <= min(READ_REGISTERS_MAX, most)
            and len(write.values) <= min(READ_WRITE_WRITE_REGISTERS_MAX, most)
        )

    def zero_steps(self) -> tuple[Step, ...]:
        """Return writes that set the set-points to zero, or to the motor's position, one by one,
        and trigger them."""
        channels = [self.channel(joint) for joint in self.joints]
        zeros = [Step(register=one.setpoint, value=0) for one in channels]
        if self.profile.goes_to_positions:
            zeros = [*present_positions(channels)]
        obey = (pair for joint in self.joints for pair in self.channel(joint).setpoint_with)
        return (*zeros, *(Step(register=name, value=raw, verify=False) for name, raw in obey))

    def directions(self, wanted: Wanted, raw: Mapping[str, int]) -> dict[str, int]:
        """Return direction register → raw value for these set-points; rest if the magnitude is
        zero."""
        found = {}
        for joint in self.joints:
            channel = self.channel(joint)
            if channel.direction is None:
                continue
            name = channel.setpoint
            forward = (of_kind(channel, wanted.get(joint.index, REST)) > 0) != joint.inverted
            direction = channel.direction.forward if forward else channel.direction.reverse
            found[channel.direction.register] = direction if raw[name] else channel.direction.rest
        return found

    def reading(
        self, joint: JointSpec, values: Mapping[str, int], last_directions: Mapping[str, int]
    ) -> Reading:
        """Return a joint's reading. `last_directions` gives a sign to a velocity without one."""
        channel, sign = self.channel(joint), 1.0
        direction = channel.direction
        if direction is not None and channel.velocity is not None:
            signed = self.profile.registers[channel.velocity].type.signed
            if not signed and last_directions.get(direction.register) == direction.reverse:
                sign = -1.0
        mask = (1 << self.profile.counter_bits) - 1
        return self._reading(joint, values, values.get(channel.position or "", 0) & mask, sign)

    def cycle_time_s(self, late_part: float = 0.0) -> float:
        """Return the time of a mean cycle on the wire: set-points and fast ranges always, an extra
        one at times. `late_part`: when the drive answers, as a part of its longest turn-around; 0:
        at once."""
        late_s = late_part * self.profile.turnaround_s
        cyclic = self.cyclic(self.setpoints({}))
        time_s = sum(self._exchange_time_s(exchange.request, late_s) for exchange in cyclic)
        if self.extra:
            extra_s = sum(self._exchange_time_s(r.request(self.unit), late_s) for r in self.extra)
            time_s += extra_s / len(self.extra) / EXTRA_EVERY_CYCLES
        return time_s

    def slowest_cycle_s(self) -> float:
        """Return the time of a cycle with an extra range, with every reply at the last moment."""
        requests = [exchange.request for exchange in self.cyclic(self.setpoints({}))]
        requests += [span.request(self.unit) for span in self.extra[:1]]
        return sum(self._exchange_time_s(r) + self.profile.turnaround_s for r in requests)

    def _exchange_time_s(self, request: Request, late_s: float = 0.0) -> float:
        """Return the time of an exchange with the silence before the request, and that before the
        answer, which is never shorter."""
        size = len(build_request(request)) + reply_bytes(request)
        return self._wire_time_s(size) + self._gap_s + max(self._gap_s, late_s)


def _end(register: Register) -> int:
    return register.address + register.type.words
