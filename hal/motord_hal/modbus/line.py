# SPDX-License-Identifier: Apache-2.0
"""The Modbus RTU line on asyncio: one task owns the port and serves the drives in turn.

In a cycle, every drive in turn gets the newest set-points and is read. One acyclic slot follows,
for one exchange of one job (configure, arm, disarm, clear) or one probe of an unresponsive drive.
So a dead drive costs the others one reply deadline at times, and a job costs them one exchange a
cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from motord_hal.asyncio_engine.line import AsyncioLine
from motord_hal.base.clock import now_s
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.ports import DirectionKind, DriveState, LineSpec, LineStats, Listener
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.modbus.drive import Drive
from motord_hal.modbus.guard import GuardedClient
from motord_hal.modbus.link import Link
from motord_hal.modbus.plan import DrivePlan
from motord_hal.modbus.timing import line_gap_s
from motord_hal.realtime.exchange import Exchange

SLOT_ALLOWANCE_S = 0.1
"""Allowance beyond the slowest cycle, for lost replies of this drive or of others."""


class ModbusRtuLine(AsyncioLine[Drive]):
    """`ports.Line` for `kind = "modbus-rtu"`, engine "asyncio"."""

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        super().__init__(spec, exchange, listener, 1.0 / spec.cycle_hz)
        client = self._new_client(spec)
        self._link = Link(client)
        self.trace = client.trace
        self._drives = [
            Drive(
                DrivePlan(joints, client.gap_s, client.wire_time_s),
                self._link,
                exchange,
                spec,
                self._say,
            )
            for joints in joints_by_unit(spec)
        ]
        self._turn = 0

    def _new_client(self, spec: LineSpec) -> GuardedClient:
        if spec.direction.kind is not DirectionKind.AUTO:
            raise HalError(
                f'{spec.name}: direction = "{spec.direction.kind.value}" is the rt engine\'s: '
                'engine = "rt" or "auto"'
            )
        return GuardedClient(
            spec.port, spec.baudrate, spec.parity, spec.stop_bits, line_gap_s(spec), spec.echo
        )

    def stats(self) -> LineStats:
        """Implement `ports.Line.stats`. Rates and percentiles are those of the newest exchanges."""
        return LineStats(
            exchanges=self._link.exchanges,
            cycles=self._cycles.count,
            reopened=self._reopened,
            errors=dict(self._link.errors),
            cycle_hz=self._cycles.rate_hz,
            requested_hz=self.spec.cycle_hz,
            wire_limit_hz=1.0 / sum(drive.plan.cycle_time_s() for drive in self._drives),
            round_trip=self._link.round_trips.percentiles(),
        )

    # ------------------------------------------------------------------------------------ its wire
    async def _open_wire(self) -> None:
        await self._link.client.open()

    def _close_medium(self) -> None:
        self._link.client.close()

    def _look(self) -> None:
        """Do nothing: bytes come only after requests."""

    async def _cycle(self) -> None:
        for drive in self._drives:
            await self._obey_setpoints()
            if drive.is_cycled:
                await drive.cycle(partial(self._wanted, drive))
        await self._obey_setpoints()
        await self._acyclic_slot()
        self._backoff.reset()

    async def _cycle_at_rest(self, drives: Sequence[Drive]) -> None:
        for drive in drives:
            await drive.cycle(dict)

    async def _acyclic_slot(self) -> None:
        """Do one exchange of one job, or one probe. Urgent jobs come first, then drives in turn."""
        self._turn += 1
        turn = self._turn % len(self._drives)
        order = [*self._drives[turn:], *self._drives[:turn]]
        working = [drive for drive in order if drive.jobs]
        urgent = [drive for drive in working if drive.jobs[0].urgent]
        silent = [
            drive
            for drive in order
            if drive.state is DriveState.UNRESPONSIVE and drive.probe_at_s <= now_s()
        ]
        if urgent:
            await urgent[0].slot()
        elif silent and (not working or self._turn % 2):
            await silent[0].probe()
        elif working:
            await working[0].slot()

    def _limit_s(self, jobs: Sequence[Job]) -> float:
        cycle_s = sum(drive.plan.slowest_cycle_s() for drive in self._drives)
        slot_s = max(self._period_s, cycle_s) + SLOT_ALLOWANCE_S
        tries = max(drive.tries for drive in self._drives)
        return sum(job.limit_s(slot_s, tries) for job in jobs)
