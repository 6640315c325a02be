# SPDX-License-Identifier: Apache-2.0
"""Stopping the drives of a CAN bus after their program has ended.

A frame that was sent is no acknowledgement: what a drive says of its power is, where it can say.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import can

from motord_hal.base.clock import now_s
from motord_hal.base.errors import HalError, NoReply, Refused
from motord_hal.can.bus import CanBus
from motord_hal.can.plan import CanPlan
from motord_hal.drives.can_profile import ABORT_CODE, Frame
from motord_hal.fieldbus.halt import halt_unit
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.fieldbus.units import joints_by_unit

SEND_WITHIN_S = 0.1
"""A queue that is full for longer is never emptied."""
CONFIRM_WITHIN_S = 0.25
RECEIVE_WITHIN_S = 0.5
LOOK_EVERY_S = 0.005


class _Unit:
    """halt.Unit on a bus."""

    def __init__(self, plan: CanPlan, bus: CanBus, rest_velocity_rad_s: float) -> None:
        self.name = ", ".join(joint.name for joint in plan.joints)
        self.profile = plan.profile
        self.rest_velocity_rad_s = rest_velocity_rad_s
        self._plan = plan
        self._bus = bus
        self._held: dict[str, int] = {}
        self._fresh: dict[str, int] = {}
        """What has come since it was looked for."""
        self._came: set[str] = set()
        """The frames that have come since one was to be confirmed."""

    def take(self, message: can.Message) -> None:
        found = self._plan.parse(
            message.arbitration_id, bytes(message.data), extended=message.is_extended_id
        )
        if found is not None:
            self._came.add(found[0].name)
            self._fresh.update(found[1])

    async def write(self, raw: Mapping[str, int]) -> None:
        self._held.update({name: raw[name] for name in self._plan.held if name in raw})
        for frame in dict.fromkeys(self._plan.frame_of(name) for name in raw):
            self._came.clear()
            until_s = now_s() + SEND_WITHIN_S
            while not self._bus.send(self._plan.write(frame, {**self._held, **raw})):
                if now_s() > until_s:
                    raise NoReply(f"the bus takes no frame in {SEND_WITHIN_S:g} s")
                await asyncio.sleep(LOOK_EVERY_S)
            if frame.confirm:
                await self._confirmed(frame)

    async def _confirmed(self, frame: Frame) -> None:
        """Raises NoReply and Refused. The next one waits for it: a drive may take one at a time."""
        until_s = now_s() + CONFIRM_WITHIN_S
        while frame.confirm not in self._came:
            self._bus.check()
            if self._plan.table.abort in self._came:
                code = self._fresh[ABORT_CODE]
                raise Refused(f"{frame.name} was refused with {code:#010x}", code)
            if now_s() > until_s:
                raise NoReply(f"{frame.name} was not confirmed in {CONFIRM_WITHIN_S:g} s")
            await asyncio.sleep(LOOK_EVERY_S)

    async def read(self, register: str) -> int:
        register = self._plan.signal(register).object or register
        frame = self._plan.read_frame_of(register)
        question = None if frame.period_s else self._plan.question(frame)
        self._fresh.pop(register, None)
        if question is not None:
            self._bus.send(question)
        until_s = now_s() + RECEIVE_WITHIN_S
        while register not in self._fresh:
            self._bus.check()
            if now_s() > until_s:
                raise NoReply(f"no {frame.name} frame in {RECEIVE_WITHIN_S:g} s")
            await asyncio.sleep(LOOK_EVERY_S)
        return self._fresh[register]

    async def halt(self) -> str:
        """As halt.halt_unit, and then what the drive says of its power: without power it has
        stopped, whatever it did not acknowledge."""
        problem = await halt_unit(self)
        power_problem = await self._confirm()
        return power_problem and (problem or power_problem)

    async def _confirm(self) -> str:
        place = self.profile.enabled
        if place is None:
            return f"{self.name}: the stop was sent; the drive cannot report whether it has power"
        until_s = now_s() + RECEIVE_WITHIN_S
        try:
            while await self.read(place.register) & place.mask == place.equals:
                if now_s() > until_s:
                    return f"{self.name}: reports that it is still enabled"
        except HalError as error:
            return f"{self.name}: {error}"
        return ""


async def halt_line(spec: LineSpec) -> list[str]:
    """All drives at once. Returns what was not acknowledged, in words. Raises PortError."""
    units: list[_Unit] = []

    def take(message: can.Message, stamp_ns: int) -> None:
        del stamp_ns
        for unit in units:
            unit.take(message)

    plans = [CanPlan(joints) for joints in joints_by_unit(spec)]
    identifiers = [one for plan in plans for one in plan.identifiers]
    bus = CanBus(spec.port, spec.baudrate, spec.data_baudrate, identifiers, take)
    await bus.open()
    try:
        units += [_Unit(plan, bus, spec.rest_velocity_rad_s) for plan in plans]
        problems = await asyncio.gather(*(unit.halt() for unit in units))
    finally:
        bus.close()
    return [problem for problem in problems if problem]
