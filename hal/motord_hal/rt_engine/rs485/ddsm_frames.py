# SPDX-License-Identifier: Apache-2.0
"""The frames of a DDSM drive (implements frames.DriveFrames)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from motord_hal.ddsm.codec import (
    FRAME_BYTES,
    build_request,
    byte_of,
    command_of,
    is_answered,
    pick,
)
from motord_hal.drives.profile import DriveProfile, Register, Step
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.modbus.plan import EXTRA_EVERY_CYCLES, WireTime, wanted_registers
from motord_hal.realtime.table import LineFrame, Seal
from motord_hal.rt_engine.rs485.frames import PlannedFrame


class DdsmFrames:
    """Implements DriveFrames for one unit with one motor. The set-points and the feedback of a
    command are one exchange."""

    def __init__(self, joints: Iterable[JointSpec], gap_s: float, wire_time_s: WireTime) -> None:
        self.joints = tuple(sorted(joints, key=lambda joint: joint.channel))
        self.profile: DriveProfile = self.joints[0].profile
        self.unit = self.joints[0].unit
        self._gap_s = gap_s
        self._exchange_s = wire_time_s(2 * FRAME_BYTES) + 2 * gap_s

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """Implement `DriveFrames.cyclic`."""
        fast, slow = wanted_registers(self.profile, self.joints)
        sent = {command_of(register) for register in self._setpoints()}
        asked = {command_of(register) for register in fast}
        return tuple(
            self._planned(command, [*fast, *slow]) for command in (*sent, *sorted(asked - sent))
        )

    def extra(self) -> tuple[PlannedFrame, ...]:
        fast, slow = wanted_registers(self.profile, self.joints)
        cyclic = {command_of(register) for register in (*self._setpoints(), *fast)}
        rest = {command_of(register): None for register in slow}
        return tuple(self._planned(command, slow) for command in rest if command not in cyclic)

    def idle(self) -> tuple[LineFrame, ...]:
        return ()

    def zero_steps(self) -> tuple[Step, ...]:
        return tuple(Step(register=register.name, value=0) for register in self._setpoints())

    def writes(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Return one frame for each command. Registers of it that are not in `raw` are 0, so that
        they move nothing."""
        by_command: dict[int, dict[Register, int]] = {}
        for name, value in raw.items():
            register = self.profile.registers[name]
            by_command.setdefault(command_of(register), {})[register] = value
        return tuple(self._frame(command, values) for command, values in by_command.items())

    def broadcasts(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Return no frames: every DDSM command is for one unit."""
        del raw
        return ()

    def read(self, name: str) -> LineFrame:
        return self._frame(command_of(self.profile.registers[name]), {})

    def raw(self, name: str, reply: bytes) -> int:
        return pick(reply, self.profile.registers[name])

    def cycle_time_s(self, late_part: float = 0.0) -> float:
        late_s = max(late_part * self.profile.turnaround_s - self._gap_s, 0.0)
        extra = bool(self.extra()) / EXTRA_EVERY_CYCLES
        return (self._exchange_s + late_s) * (len(self.cyclic()) + extra)

    def slowest_cycle_s(self) -> float:
        exchanges = len(self.cyclic()) + bool(self.extra())
        return exchanges * (self._exchange_s + self.profile.turnaround_s)

    # ------------------------------------------------------------------------------------ parts
    def _setpoints(self) -> list[Register]:
        channels = (self.profile.channels[joint.channel] for joint in self.joints)
        return [self.profile.registers[channel.setpoint] for channel in channels]

    def _planned(self, command: int, wanted: Iterable[Register]) -> PlannedFrame:
        return PlannedFrame(
            self._frame(command, {}),
            {r.name: byte_of(r) for r in self._setpoints() if command_of(r) == command},
            {r.name: byte_of(r) for r in wanted if command_of(r) == command},
        )

    def _frame(self, command: int, raw: Mapping[Register, int]) -> LineFrame:
        """Return the frame of a command. Its reply is recognised by unit and check sum alone."""
        answered = is_answered(command)
        seal = Seal.CRC8 if answered else Seal.NONE
        return LineFrame(
            request=build_request(self.unit, command, raw),
            reply_bytes=FRAME_BYTES if answered else 0,
            match=bytes((self.unit,)) if answered else b"",
            request_seal=seal,
            reply_seal=seal,
        )
