# SPDX-License-Identifier: Apache-2.0
"""A simulated drive, which carries out a profile on motors.

The profile's sequences give the control words their meaning: the drive is enabled when the writes
of `arm` have been made in their order, and disabled after those of `disarm` or `quick_stop`. It is
as strict as a real drive: a set-point stays in its register through a disarming, so a master that
enables it with an old set-point moves the motor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from motord_hal.drives.can_profile import Frame
from motord_hal.drives.profile import Channel, DriveProfile, FaultBit, Step
from motord_hal.modbus.codec import Function, Request
from motord_hal.servo.packets import KINDS as SERVO_KINDS
from motord_hal.sim.axis import Axis, Defect, Motor, new_motor
from motord_hal.sim.can.content import CanContent
from motord_hal.sim.journal import Journal
from motord_hal.sim.positioning import approach_rad_s
from motord_hal.sim.reports import Reports
from motord_hal.sim.rs485.content import ControlTable, FrameContent, NamedContent
from motord_hal.sim.rs485.registers import BUSY, ILLEGAL_FUNCTION, Refusal, RegisterFile


@dataclass(slots=True)
class DriveStats:
    requests: int = 0
    exceptions: int = 0
    gap_violations: int = 0
    """Number of requests that came before the silent interval was over."""
    watchdog_bites: int = 0
    reboots: int = 0
    flashed: int = 0
    """Number of settings that were stored slowly (slow-flash)."""


class _Sequence:
    """Detector of the writes of one sequence of the profile, in their order."""

    def __init__(self, steps: tuple[Step, ...]) -> None:
        self._writes = [(step.register, step.value) for step in steps if step.value is not None]
        self._done = 0

    def feed(self, name: str, raw: int) -> bool:
        """Take a write. Return True if it completes the sequence. Writes to other registers are
        ignored."""
        if all(name != register for register, _ in self._writes):
            return False
        if self._writes[self._done] == (name, raw):
            self._done += 1
        else:
            self._done = int(self._writes[0] == (name, raw))
        if self._done < len(self._writes):
            return False
        self._done = 0
        return True


class SimulatedDrive:
    """One unit on a line. `watchdog_s` adds a watchdog if the profile has none; 0: no watchdog."""

    def __init__(
        self,
        profile: DriveProfile,
        unit: int,
        axes: Mapping[int, Axis],
        *,
        watchdog_s: float = 0.0,
    ) -> None:
        self.profile = profile
        self.unit = unit
        self.stats = DriveStats()
        self.journal = Journal()
        self.registers = _content(profile)
        self._settings = _settings(profile)
        self._defects: tuple[Defect, ...] = ()
        self._setting_taken = False
        self._watchdog_s = watchdog_s
        self._motors = {
            number: new_motor(profile, number, axes[number]) for number in profile.channels
        }
        self._sequences = {
            name: _Sequence(getattr(profile, name))
            for name in ("arm", "disarm", "quick_stop", "clear_fault")
            if _commands(profile, name)
        }
        self._switching = _switching(profile)
        self._positions = profile.goes_to_positions
        self._always_on = not any(step.value is not None for step in profile.arm)
        self._switch(on=self._always_on)
        self._received_s = math.inf
        self._off_until_s = -math.inf
        self._keeps_counter = False
        self._flash_until_s = -math.inf
        self._flash_busy = False
        self.homed = profile.homed is not None
        """Whether the position has a reference."""
        Reports(profile, self.registers, self._motors, self.enabled, lambda: self.homed)

    # ------------------------------------------------------------------------------- state, read
    @property
    def functions(self) -> frozenset[int]:
        """Modbus functions that the drive supports by its profile."""
        spoken = {Function.READ_HOLDING, Function.WRITE_SINGLE, self.profile.write_function}
        both = self.profile.read_write_function
        return frozenset(spoken if both is None else spoken | {both})

    @property
    def on(self) -> bool:
        """Whether the drive has power; False during a reboot."""
        return self._off_until_s == -math.inf

    def enabled(self, channel: int) -> bool:
        """Whether this channel's motor follows its set-point."""
        motor = self._motors[channel]
        return self.on and motor.switched_on and not motor.stopped_by_fault

    # -------------------------------------------------------------------------------- the wire
    def receives(self, now_s: float) -> bool:
        """Whether the drive receives; False while it stores a setting."""
        return self._flash_busy or now_s >= self._flash_until_s

    def takes_setting(self) -> bool:
        """Whether the last request wrote a register that is written only at set-up. Clears this
        state."""
        taken, self._setting_taken = self._setting_taken, False
        return taken

    def flash(self, until_s: float, *, busy: bool) -> None:
        """Store a setting until `until_s`: without an answer, or refusing with exception 6 if
        `busy`."""
        self.stats.flashed += 1
        self._flash_until_s, self._flash_busy = until_s, busy

    def execute(self, request: Request, now_s: float) -> tuple[int, ...]:
        """Carry out a request; return the read words. Raises Refusal."""
        self.stats.requests += 1
        self._received_s = now_s
        try:
            if now_s < self._flash_until_s:
                raise Refusal(BUSY, "a setting is being stored")
            words = self._execute(request)
        except Refusal:
            self.stats.exceptions += 1
            raise
        if words:
            self.journal.add(now_s, request.function, request.address, words)
        return words

    def _execute(self, request: Request) -> tuple[int, ...]:
        registers = self.registers
        if request.function not in self.functions or not isinstance(registers, RegisterFile):
            raise Refusal(ILLEGAL_FUNCTION, f"function {request.function}")
        if request.function == Function.READ_HOLDING:
            return registers.read(request.address, request.count)
        if request.function != Function.READ_WRITE:
            self._obey(registers.write(request.address, request.values))
            return ()
        registers.read(request.address, request.count)  # refused before anything is written
        self._obey(registers.write(request.write_address, request.values))
        return registers.read(request.address, request.count)

    def execute_ddsm(self, frame: bytes, now_s: float) -> bytes | None:
        """Carry out a good DDSM frame; return the answer, or None for an unknown command."""
        assert isinstance(self.registers, FrameContent)
        self.stats.requests += 1
        self._received_s = now_s
        self._obey(self.registers.write(frame))
        reply = self.registers.reply(self.unit, frame[1])
        if reply is not None:
            self.journal.add(now_s, frame[1], 0, tuple(reply))
        return reply

    def sends(self, frame: Frame) -> bool:
        """Whether the drive sends this frame without a request now."""
        del frame
        return True

    def obeys(self, frame: Frame) -> bool:
        """Whether the drive takes this frame now."""
        del frame
        return True

    def due(self, frame: Frame, data: bytes) -> list[tuple[Frame, bytes]]:
        """Return the frames that take effect now that this frame has come."""
        return [(frame, data)]

    def execute_can(self, written: list[tuple[str, int]], now_s: float) -> None:
        """Carry out a frame to this drive that had these signals."""
        self.stats.requests += 1
        self._received_s = now_s
        self._obey(written)

    def obey(self, written: Mapping[str, int], now_s: float) -> None:
        """Carry out a frame that has every register. Only a change counts as a step of a
        sequence."""
        self.stats.requests += 1
        self._received_s = now_s
        changed = [
            (name, raw) for name, raw in written.items() if raw != self.registers.stored(name)
        ]
        for name, raw in changed:
            self.registers.put(name, raw)
        self._obey(changed)

    def _obey(self, written: list[tuple[str, int]]) -> None:
        for name, raw in written:
            if name in self._switching:
                self._switch(on=not any(m.stopped_by_fault for m in self._motors.values()))
            self._follow_sequences(name, raw)
            self._setting_taken |= name in self._settings
        for motor in self._motors.values():
            self._take_setpoint(motor, dict(written))
        if written:
            self._apply()

    def _take_setpoint(self, motor: Motor, written: Mapping[str, int]) -> None:
        """Take a set-point that counts only with other registers, if all came at once."""
        channel = motor.channel
        whole = all(written.get(name) == raw for name, raw in channel.setpoint_with)
        if channel.setpoint_with and channel.setpoint in written and whole:
            motor.sent_raw = written[channel.setpoint]

    def _follow_sequences(self, name: str, raw: int) -> None:
        done = {key for key, sequence in self._sequences.items() if sequence.feed(name, raw)}
        if "clear_fault" in done:
            for motor in self._motors.values():
                motor.faults.clear()
        if self._always_on:
            if "disarm" in done:
                self._zero_setpoints()
            return
        if "arm" in done:
            self._switch(on=not any(motor.stopped_by_fault for motor in self._motors.values()))
        if "quick_stop" in done:
            self._brake()
        elif "disarm" in done:
            self._switch(on=False)

    def _switch(self, *, on: bool) -> None:
        for motor in self._motors.values():
            motor.switched_on = on
            motor.braking = False
            motor.sent_raw = None if motor.channel.position_setpoint else 0

    # ---------------------------------------------------------------------------------- motors
    def _brake(self) -> None:
        """Start a quick stop: along the drive's own deceleration to rest, then without power."""
        for number, motor in self._motors.items():
            motor.braking = motor.braking or self.enabled(number)
            motor.switched_on = self._always_on
        if self._always_on:
            self._zero_setpoints()

    def _zero_setpoints(self) -> None:
        for motor in self._motors.values():
            if motor.channel.position_setpoint is not None:
                continue  # 0 would be a target
            motor.sent_raw = 0
            self.registers.put(motor.channel.setpoint, 0)
            if motor.channel.direction is not None:
                self.registers.put(motor.channel.direction.register, motor.channel.direction.rest)

    def _apply(self) -> None:
        for number, motor in self._motors.items():
            wheel = motor.axis.wheel
            if self.enabled(number):
                motor.braking = False
                self._follow_setpoint(motor)
            elif motor.braking and wheel.velocity_rad_s != 0.0:
                wheel.brake()
            else:
                motor.braking = False
                wheel.coast()

    def _follow_setpoint(self, motor: Motor) -> None:
        channel, axis = motor.channel, motor.axis
        if "runaway" in motor.defects:
            axis.wheel.turn(motor.defects["runaway"])
            return
        name = channel.setpoint
        kept = channel.setpoint_with or channel.handshake
        raw = motor.sent_raw if kept else self.registers.stored(name)
        if channel.position_setpoint is not None:
            axis.wheel.turn(0.0 if raw is None else approach_rad_s(self.profile, motor, raw))
            return
        raw = raw or 0
        value = self.profile.registers[name].to_si(raw) * self._sign(channel)
        if channel.velocity_setpoint is not None:
            axis.wheel.turn(value / axis.motor_per_wheel)
        elif channel.torque_setpoint is not None:
            axis.wheel.drive(value * axis.motor_per_wheel)
        else:
            axis.wheel.push(value * axis.sign, axis.full_duty_rad_s)

    def _sign(self, channel: Channel) -> float:
        if channel.direction is None:
            return 1.0
        direction = self.registers.stored(channel.direction.register)
        return {channel.direction.forward: 1.0, channel.direction.reverse: -1.0}.get(direction, 0.0)

    # ------------------------------------------------------------------------------------ time
    def tick(self, now_s: float) -> None:
        """Advance the drive's own clock, once in each sub-step of the plant."""
        if not self.on:
            if now_s >= self._off_until_s:
                self._power_up()
            return
        if self._watchdog_bites(now_s):
            self.stats.watchdog_bites += 1
            self._received_s = math.inf
            self._brake()
            self._apply()
        elif self._positions or any(motor.braking for motor in self._motors.values()):
            self._apply()

    def _watchdog_bites(self, now_s: float) -> bool:
        if self._received_s == math.inf:
            return False
        watchdog = self.profile.watchdog
        limit_s = self._watchdog_s
        if watchdog is not None:
            register = self.profile.registers[watchdog.register]
            limit_s = register.to_si(self.registers.stored(watchdog.register))
        return limit_s > 0.0 and now_s - self._received_s > limit_s

    def reboot(self, now_s: float, for_s: float, *, keeps_counter: bool = False) -> None:
        """Switch the power off for `for_s`. Then everything is as after power-up, except the
        counter if `keeps_counter` (the drive's logic kept its power)."""
        self.stats.reboots += 1
        self._keeps_counter = keeps_counter
        self._flash_until_s = -math.inf
        self._off_until_s = now_s + for_s
        self._switch(on=False)
        self._apply()

    def _power_up(self) -> None:
        self._off_until_s = -math.inf
        self._received_s = math.inf
        self.registers.power_up()
        self._switch(on=self._always_on)
        for motor in self._motors.values():
            motor.faults.clear()
            if not self._keeps_counter:
                motor.restart_counter()
        self.homed &= self._keeps_counter
        self._apply()

    # ---------------------------------------------------------------------------------- faults
    def find_fault(self, channel: int, bit: int | None, code: int | None) -> FaultBit:
        """Return one of the profile's faults. Raises ValueError if it has no such fault."""
        for fault in self.profile.faults:
            motor = self._motors.get(channel)
            if (fault.bit, fault.code) == (bit, code) and motor and motor.channel.fault:
                return fault
        what = f"code {code}" if bit is None else f"bit {bit}"
        raise ValueError(
            f"{self.profile.name} (unit {self.unit}) has no fault {what} on channel {channel}"
        )

    def raise_fault(self, channel: int, bit: int | None = None, code: int | None = None) -> None:
        """Latch one of the profile's faults. Raises ValueError if it has no such fault."""
        fault, motor = self.find_fault(channel, bit, code), self._motors[channel]
        if fault not in motor.faults:
            motor.faults.append(fault)
        if motor.stopped_by_fault:
            motor.switched_on = self._always_on
        self._apply()

    def suffer(self, defects: tuple[Defect, ...]) -> None:
        """Replace the present defects of the motors with these."""
        if defects == self._defects:
            return
        self._defects = defects
        for number, motor in self._motors.items():
            motor.suffer({one.kind: one.value for one in defects if one.channel in (None, number)})
            self._apply()

    def start_near_wrap(self) -> None:
        """Set the counters so that a quarter turn forward wraps them, now and at each power-up."""
        for motor in self._motors.values():
            motor.start_near_wrap(self.profile)

    def tag_counters(self) -> None:
        """Start each motor's counter at its own number, so that a count shows its motor."""
        for number, motor in self._motors.items():
            motor.start_at(tagged_count(self.profile.counter_bits, self.unit, number))


def _content(profile: DriveProfile) -> RegisterFile | NamedContent:
    if profile.can is not None:
        return CanContent(profile, profile.can)
    if profile.protocol == "ddsm":
        return FrameContent(profile)
    if profile.protocol in SERVO_KINDS:
        return ControlTable(profile)
    words = profile.protocol in ("modbus-rtu", "roboclaw")
    return RegisterFile(profile) if words else NamedContent(profile)


def _commands(profile: DriveProfile, name: str) -> bool:
    """Whether a sequence does more than write set-points, which only set a speed."""
    setpoints = {channel.setpoint for channel in profile.channels.values()}
    writes = {step.register for step in getattr(profile, name) if step.value is not None}
    return profile.can is None or not writes or not writes <= setpoints


def _switching(profile: DriveProfile) -> set[str]:
    """Return the set-points that switch the motor on by themselves."""
    if profile.can is None or profile.can.idle_setpoints:
        return set()
    return {channel.setpoint for channel in profile.channels.values()}


def _settings(profile: DriveProfile) -> frozenset[str]:
    """Return the registers that are written once, at the set-up: not commands."""
    once = {step.register for step in profile.configure if step.value is not None}
    once |= {profile.watchdog.register} if profile.watchdog else set()
    sequences = (profile.arm, profile.disarm, profile.quick_stop, profile.clear_fault)
    often = {step.register for steps in sequences for step in steps}
    for channel in profile.channels.values():
        often |= channel.commands
    return frozenset(once - often)


def tagged_count(bits: int, unit: int, channel: int) -> int:
    """Return the start of a tagged counter: the unit is its highest byte, then three bits for the
    channel."""
    return (unit << bits >> 8) + (channel - 1 << bits >> 11)
