# SPDX-License-Identifier: Apache-2.0
"""A simulated CANopen drive with the state machine of CiA 402-2, 8.3. It uses the names of objects
in the profile `cia402`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from motord_hal.drives.can_profile import Frame, Signal
from motord_hal.drives.profile import DriveProfile
from motord_hal.sim.axis import Axis
from motord_hal.sim.rs485.content import NamedContent
from motord_hal.sim.rs485.drive import SimulatedDrive

SWITCH_ON_DISABLED, READY, SWITCHED_ON, OPERATION = 0x40, 0x21, 0x23, 0x27
QUICK_STOP_ACTIVE, FAULT = 0x07, 0x08
_FAULT_RESET = 0x80
_NEW_SETPOINT, _AT_ONCE = 0x10, 0x20
"""Bits of the control word in profile position mode (CiA 402-2, 10.3): the rising edge of the first
makes the drive take the target, the second ends the previous move."""
_TAKEN = 0x1000
"""Bit of the status word: set-point acknowledge, until the first of those bits is 0 again."""
_INVALID = 0x8000_0000
"""Bit of a COB-ID: the PDO is off (CiA 301, 7.5.2.35)."""
_OPERATIONAL = 5
_SYNCHRONOUS_MAX = 240
"""Greatest transmission type that goes by SYNC (CiA 301, 7.5.2.35)."""
_NMT_STATES = {1: _OPERATIONAL, 2: 4, 128: 127, 129: 127, 130: 127}
"""NMT command → state: CiA 301, 7.2.8.3.1. After a reset the state is pre-operational."""


def speaks_cia402(profile: DriveProfile) -> bool:
    """Whether the profile has the objects that this drive needs."""
    needed = {"control_word", "status_word", "nmt_command", "nmt_state", "mode", "mode_shown"}
    return profile.can is not None and needed <= profile.registers.keys()


class Cia402Drive(SimulatedDrive):
    """SDO server, NMT slave, PDOs by their set-up, and the state machine."""

    def __init__(
        self,
        profile: DriveProfile,
        unit: int,
        axes: Mapping[int, Axis],
        *,
        watchdog_s: float = 0.0,
    ) -> None:
        super().__init__(profile, unit, axes, watchdog_s=watchdog_s)
        self._state = SWITCH_ON_DISABLED
        self._control = 0
        self._taken = False
        """Whether the drive has acknowledged a target."""
        self._kept: dict[str, tuple[Frame, bytes]] = {}
        """Name → PDO that waits for the next SYNC."""
        self.registers.make_live("status_word", self._status)
        assert isinstance(self.registers, NamedContent)  # every drive on a CAN bus has it
        for one in profile.registers.values():
            if isinstance(one, Signal) and one.object:
                self.registers.make_live(one.object, partial(self.registers.value, one.name))

    def sends(self, frame: Frame) -> bool:
        """Whether the drive sends this frame now, by its set-up."""
        stored = self.registers.stored
        if frame.name == "heartbeat":
            return stored("producer_heartbeat") > 0
        if not frame.name.startswith("tpdo_"):
            return True
        timed = self._is_synchronous(frame.name) or stored(f"{frame.name}_event_time") > 0
        return timed and stored(f"{frame.name}_count") > 0 and self._is_on(frame.name)

    def _is_synchronous(self, pdo: str) -> bool:
        return self.registers.stored(f"{pdo}_type") <= _SYNCHRONOUS_MAX

    def due(self, frame: Frame, data: bytes) -> list[tuple[Frame, bytes]]:
        """Implement `SimulatedDrive.due`. A synchronous PDO takes effect with the next SYNC, the
        newest of each (CiA 301, 7.2.2.2)."""
        if frame.name == "sync":
            kept = [*self._kept.values()]
            self._kept.clear()
            return [*kept, (frame, data)]
        if frame.name.startswith("rpdo_") and self._is_synchronous(frame.name):
            self._kept[frame.name] = (frame, data)
            return []
        return [(frame, data)]

    def obeys(self, frame: Frame) -> bool:
        """Whether the drive takes this frame now, by its set-up."""
        return not frame.name.startswith("rpdo_") or self._is_on(frame.name)

    def _is_on(self, pdo: str) -> bool:
        operational = self.registers.stored("nmt_state") == _OPERATIONAL
        return operational and not self.registers.stored(f"{pdo}_id") & _INVALID

    def execute_can(self, written: list[tuple[str, int]], now_s: float) -> None:
        """Implement `SimulatedDrive.execute_can`."""
        for name, raw in written:
            if name == "nmt_command":
                self.registers.put("nmt_state", _NMT_STATES.get(raw, 127))
            elif name == "mode":
                self.registers.put("mode_shown", raw)
        super().execute_can([], now_s)
        for name, raw in written:
            if name in ("control_word", "control_object"):
                self._obey_control(raw)
        self._apply()

    def _power_up(self) -> None:
        self._state, self._control = SWITCH_ON_DISABLED, 0
        self._taken = False
        self._kept.clear()
        super()._power_up()

    def _status(self) -> int:
        homed = self.profile.homed
        more = homed.equals if homed and homed.register == "status_word" and self.homed else 0
        return self._state_now() | more | (_TAKEN if self._taken else 0)

    def _state_now(self) -> int:
        motors = self._motors.values()
        if any(motor.stopped_by_fault for motor in motors):
            self._state = FAULT
        elif self._state == OPERATION and not any(motor.switched_on for motor in motors):
            self._state = SWITCH_ON_DISABLED  # its watchdog has expired
        elif self._state == QUICK_STOP_ACTIVE and not any(motor.braking for motor in motors):
            self._state = SWITCH_ON_DISABLED  # 605Ah, 2
        return self._state

    def _obey_control(self, word: int) -> None:
        """Do one transition for a command, in the order of CiA 402-2, table 27."""
        rising, self._control = word & ~self._control, word
        state = self._state_now()
        if state == FAULT:
            if rising & _FAULT_RESET:
                for motor in self._motors.values():
                    motor.faults.clear()
                self._state = SWITCH_ON_DISABLED
            return
        self._state = _next(state, word)
        if self._state == QUICK_STOP_ACTIVE:
            if state != QUICK_STOP_ACTIVE:
                self._brake()
        elif (self._state == OPERATION) != (state == OPERATION):
            self._switch(on=self._state == OPERATION)
        self._take_target(word, rising)

    def _take_target(self, word: int, rising: int) -> None:
        """Take a target in profile position mode. One without "at once" is ignored."""
        self._taken &= bool(word & _NEW_SETPOINT)
        if self._state == OPERATION and rising & _NEW_SETPOINT and word & _AT_ONCE:
            for motor in self._motors.values():
                if motor.channel.handshake is not None:
                    motor.sent_raw = self.registers.stored(motor.channel.setpoint)
                    self._taken = True


def _next(state: int, word: int) -> int:
    """Return the state after a control word. Faults are handled elsewhere."""
    if not word & 0x02:  # disable voltage
        return SWITCH_ON_DISABLED
    if not word & 0x04:  # quick stop
        running = state in (OPERATION, QUICK_STOP_ACTIVE)
        return QUICK_STOP_ACTIVE if running else SWITCH_ON_DISABLED
    if state == QUICK_STOP_ACTIVE:
        return state
    if not word & 0x01:  # shutdown
        return READY
    if word & 0x08 and state in (SWITCHED_ON, OPERATION):  # enable operation
        return OPERATION
    if state in (READY, SWITCHED_ON, OPERATION):  # switch on, disable operation
        return SWITCHED_ON
    return state
