# SPDX-License-Identifier: Apache-2.0
"""Simulated bus servos: their control table, their packets, and their line.

The behaviour is from the makers' manuals. Each servo answers a sync read in the order of the
request; no servo answers a broadcast write. A Dynamixel refuses values out of range, its EEPROM
while it has torque (access error), and goal values after its bus watchdog has expired, until 0 is
written to that (ROBOTIS e-Manual, XL430-W250, 2.4: Bus Watchdog (98)). A servo of Feetech's SCS
series is a motor only while both its angle limits are 0, and writes below address 40 survive a
power cut only while the lock is open (`ftservo-python-sdk`, scscl.py).
"""

from __future__ import annotations

from collections.abc import Mapping

from motord_hal.drives.profile import DriveProfile
from motord_hal.servo.packets import (
    BROADCAST_UNIT,
    Instruction,
    Packet,
    build_fast_status,
    decode,
    has_no_sync_read,
    packets_of,
    size_bytes,
)
from motord_hal.sim.axis import Axis, Motor
from motord_hal.sim.rs485.content import ControlTable
from motord_hal.sim.rs485.drive import SimulatedDrive

EEPROM_END = 64
"""End of a Dynamixel's EEPROM: lower addresses are kept without power, and locked by torque."""
ANGLE_LIMITS, LOCK = ("minimum_angle", "maximum_angle"), "lock"
"""Registers in an SCS profile for motors."""
SCS_EEPROM_END = 40
RANGE_ERROR, LENGTH_ERROR, ACCESS_ERROR, INSTRUCTION_ERROR = 4, 5, 7, 2
REBOOT_S = 0.1
"""Time for which a rebooting servo receives nothing."""


class ServoError(Exception):
    """Error with which the servo answers, by its number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class SimulatedServo(SimulatedDrive):
    """One servo with its profile and its packets."""

    registers: ControlTable

    def __init__(
        self, profile: DriveProfile, unit: int, axes: Mapping[int, Axis], *, watchdog_s: float = 0.0
    ) -> None:
        super().__init__(profile, unit, axes, watchdog_s=watchdog_s)
        # a goal velocity of zero holds the wheel; it ends nothing
        self._sequences.pop("quick_stop", None)
        self.packets = packets_of(profile.protocol)
        self._strict = profile.protocol == "dynamixel"
        self._scs_motor = has_no_sync_read(profile) and not profile.goes_to_positions
        self._saved: dict[str, int] = {}
        """Values that an SCS servo keeps through a power cut."""
        self._now_s = 0.0

    # ------------------------------------------------------------------------------- the wire
    def execute_packet(self, packet: Packet, now_s: float) -> bytes | None:
        """Carry out a packet for this servo, or for all. Return the status, or None: the servo is
        silent."""
        error, data = self.outcome_of(packet, now_s)
        pinged = packet.code == Instruction.PING and self._strict
        if packet.unit == BROADCAST_UNIT and packet.code != Instruction.SYNC_READ and not pinged:
            return None
        return self.packets.build_status(self.unit, error, data)

    def outcome_of(self, packet: Packet, now_s: float) -> tuple[int, bytes]:
        """Carry out a packet like `execute_packet`; return error and data of its status."""
        self.stats.requests += 1
        self._received_s = self._now_s = now_s
        error, data = 0, b""
        try:
            data = self._do(packet)
        except ServoError as refusal:
            self.stats.exceptions += 1
            error = refusal.number
        if self._strict and any(motor.faults for motor in self._motors.values()):
            error |= 0x80  # alert: hardware error status is not zero
        if data:
            self.journal.add(now_s, packet.code, self._first(packet), tuple(data))
        return error, data

    def _first(self, packet: Packet) -> int:
        return int.from_bytes(packet.parameters[: len(self.packets.number(0))], "little")

    def _do(self, packet: Packet) -> bytes:
        width = len(self.packets.number(0))
        match packet.code:
            case Instruction.PING:
                return (
                    self.registers.read(0, 2) + self.registers.read(6, 1) if self._strict else b""
                )
            case Instruction.READ | Instruction.SYNC_READ | Instruction.FAST_SYNC_READ:
                count = int.from_bytes(packet.parameters[width : 2 * width], "little")
                return self.registers.read(self._first(packet), count)
            case Instruction.WRITE:
                self._write(self._first(packet), packet.parameters[width:])
            case Instruction.SYNC_WRITE:
                count = int.from_bytes(packet.parameters[width : 2 * width], "little")
                rows = packet.parameters[2 * width :]
                for at in range(0, len(rows) - count, count + 1):
                    if rows[at] == self.unit:
                        self._write(self._first(packet), rows[at + 1 : at + 1 + count])
            case Instruction.REBOOT if self._strict:
                self.reboot(self._now_s, REBOOT_S, keeps_counter=False)
            case _:
                raise ServoError(INSTRUCTION_ERROR)
        return b""

    def _write(self, address: int, data: bytes) -> None:
        if self._strict:
            self._refuse(address, data)
        written = self.registers.write(address, data)
        if self._scs_motor and not self.registers.stored(LOCK):
            self._save(written)
        self._obey(written)

    def _save(self, written: list[tuple[str, int]]) -> None:
        places = self.profile.registers
        kept = {name: raw for name, raw in written if places[name].address < SCS_EEPROM_END}
        self.stats.flashed += bool(kept)
        self._saved |= kept

    def _power_up(self) -> None:
        super()._power_up()
        for name, raw in self._saved.items():
            self.registers.put(name, raw)

    def _follow_setpoint(self, motor: Motor) -> None:
        if self._scs_motor and any(map(self.registers.stored, ANGLE_LIMITS)):
            motor.axis.wheel.turn(0.0)  # it holds a position
            return
        super()._follow_setpoint(motor)

    def _refuse(self, address: int, data: bytes) -> None:
        if address < EEPROM_END and any(motor.switched_on for motor in self._motors.values()):
            raise ServoError(ACCESS_ERROR)
        setpoints = {channel.setpoint for channel in self.profile.channels.values()}
        for register in self.registers.places:
            place = register.address - address
            if not 0 <= place < len(data):
                continue
            if place + size_bytes(register) > len(data):
                raise ServoError(LENGTH_ERROR)
            if "w" not in register.access:
                raise ServoError(ACCESS_ERROR)
            value = decode(register, data[place:]) * register.scale
            low, high = register.minimum, register.maximum
            out = (low is not None and value < low) or (high is not None and value > high)
            if out or (register.name in setpoints and self._bitten):
                raise ServoError(RANGE_ERROR)

    # ------------------------------------------------------------------------------- its watchdog
    @property
    def _bitten(self) -> bool:
        watchdog = self.profile.watchdog
        return watchdog is not None and self.registers.stored(watchdog.register) < 0

    def _watchdog_bites(self, now_s: float) -> bool:
        on = any(motor.switched_on for motor in self._motors.values())
        return on and not self._bitten and super()._watchdog_bites(now_s)

    def _brake(self) -> None:
        """Stop because the watchdog has expired: a Dynamixel holds a velocity of zero, with
        torque."""
        if self.profile.watchdog is None:
            super()._brake()
            return
        self.registers.put(self.profile.watchdog.register, -1)
        for channel in self.profile.channels.values():
            held = self.registers.value(channel.position or "") if channel.position_setpoint else 0
            self.registers.put(channel.setpoint, held)


def answer_servos(
    packet: Packet, drives: Mapping[int, SimulatedDrive], now_s: float
) -> list[tuple[SimulatedServo, bytes]]:
    """Carry out a good packet on a line's servos; return their answers, in their order."""
    servos = {unit: drive for unit, drive in drives.items() if isinstance(drive, SimulatedServo)}
    servos = {unit: servo for unit, servo in servos.items() if servo.on}
    if packet.code == Instruction.FAST_SYNC_READ:
        return _answer_together(packet, servos, now_s)
    if packet.unit != BROADCAST_UNIT:
        order = [packet.unit]
    elif packet.code == Instruction.SYNC_READ:
        order = list(_asked(packet, servos))
    else:
        order = sorted(servos)
    replies = []
    for unit in order:
        servo = servos.get(unit)
        if servo is not None and packet.code == Instruction.SYNC_READ:
            servo = None if has_no_sync_read(servo.profile) else servo
        reply = None if servo is None else servo.execute_packet(packet, now_s)
        if servo is not None and reply is not None:
            replies.append((servo, reply))
    return replies


def _answer_together(
    packet: Packet, servos: Mapping[int, SimulatedServo], now_s: float
) -> list[tuple[SimulatedServo, bytes]]:
    """Answer a fast sync read. Each servo waits for the previous one: a missing servo ends the
    packet."""
    asked, answers = _asked(packet, servos), []
    for unit in asked:
        servo = servos.get(unit)
        if servo is None or servo.profile.protocol != "dynamixel":
            break
        answers.append((servo, servo.outcome_of(packet, now_s)))
    blocks = ((servo.unit, error, data) for servo, (error, data) in answers)
    parts = build_fast_status(len(asked), blocks)
    return [(servo, part) for (servo, _), part in zip(answers, parts, strict=True)]


def _asked(packet: Packet, servos: Mapping[int, SimulatedServo]) -> bytes:
    """Return the units that a sync read names."""
    for servo in servos.values():
        return packet.parameters[2 * len(servo.packets.number(0)) :]
    return b""
