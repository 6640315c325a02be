# SPDX-License-Identifier: Apache-2.0
"""Stopping the drives behind a gateway after their program has ended."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from motord_hal.fieldbus.halt import halt_unit
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.modbus.guard import GuardedClient
from motord_hal.modbus.plan import DrivePlan, ReadRange
from motord_hal.modbus.tcp_guard import GatewayClient


class _Unit:
    """halt.Unit by one request at a time; the client sees to that."""

    def __init__(self, plan: DrivePlan, client: GuardedClient, rest_velocity_rad_s: float) -> None:
        self.name = ", ".join(joint.name for joint in plan.joints)
        self.profile = plan.profile
        self.rest_velocity_rad_s = rest_velocity_rad_s
        self._plan = plan
        self._client = client

    async def write(self, raw: Mapping[str, int]) -> None:
        for request in self._plan.writes(raw):
            within_s = self._client.reply_deadline_s(request, self.profile.turnaround_s)
            await self._client.exchange(request, within_s, urgent=True)

    async def read(self, register: str) -> int:
        found = self.profile.registers[register]
        span = ReadRange(found.address, found.type.words, (found,))
        request = span.request(self._plan.unit)
        within_s = self._client.reply_deadline_s(request, self.profile.turnaround_s)
        answer = await self._client.exchange(request, within_s)
        return span.decode(answer.values)[register]


async def halt_line(spec: LineSpec) -> list[str]:
    """As `halt_units`, through a gateway."""
    return await halt_units(spec, GatewayClient(spec))


async def halt_units(spec: LineSpec, client: GuardedClient) -> list[str]:
    """All drives at once. Returns what was not acknowledged, in words. Raises PortError."""
    await client.open()
    try:
        plans = (DrivePlan(j, client.gap_s, client.wire_time_s) for j in joints_by_unit(spec))
        units = (_Unit(plan, client, spec.rest_velocity_rad_s) for plan in plans)
        problems = await asyncio.gather(*map(halt_unit, units))
    finally:
        client.close()
    return [problem for problem in problems if problem]
