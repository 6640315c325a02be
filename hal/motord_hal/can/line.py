# SPDX-License-Identifier: Apache-2.0
"""The CAN line on asyncio: one task sends, for all drives of a CAN bus.

In a cycle, every drive gets the newest set-points and requests for what it does not send by itself,
and does one step of its jobs. Received frames are taken in as they come; they trigger no sending.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import can

from motord_hal.asyncio_engine.line import STOPPING_CYCLE_S, AsyncioLine
from motord_hal.base.clock import now_s
from motord_hal.can.bus import CanBus, receives_own, shows_own
from motord_hal.can.drive import CanDrive
from motord_hal.can.identifiers import ForeignSenders, OwnFrames, can_plans, sendings
from motord_hal.can.motion_gate import MotionGate
from motord_hal.can.plan import STEADY_S, Sent, wire_limit_hz
from motord_hal.fieldbus.job import Job
from motord_hal.fieldbus.plan import Wanted
from motord_hal.fieldbus.ports import EventKind, LineSpec, LineStats, Listener
from motord_hal.realtime.exchange import Exchange


class CanLine(AsyncioLine[CanDrive]):
    """`ports.Line` for `kind = "can"`, engine "asyncio"."""

    unresponsive_text = "the CAN bus takes no frames, or it was not confirmed"

    def __init__(self, spec: LineSpec, exchange: Exchange, listener: Listener) -> None:
        super().__init__(spec, exchange, listener, 1.0 / spec.cycle_hz)
        plans = can_plans(spec)
        identifiers = [one for plan in plans for one in plan.identifiers]
        self._syncs = tuple(dict.fromkeys(plan.sync for plan in plans if plan.sync))
        self._carry_setpoints = {one for plan in plans for one in plan.setpoint_identifiers}
        self._sendings = {
            (one.identifier, one.extended, one.remote): one for one in sendings(plans)
        }
        self._foreign_senders = ForeignSenders()
        self._shows_own = receives_own(spec.port) or shows_own(spec.port)
        self._own_frames = OwnFrames()
        own = [(one.identifier, one.extended) for one in self._sendings.values()]
        wire = (spec.port, spec.baudrate, spec.data_baudrate)
        self._bus = CanBus(*wire, identifiers, self._take_frame, self._warn, own)
        self.trace = self._bus.trace
        self._gate = MotionGate(1.0 / spec.cycle_hz, receives_own=receives_own(spec.port))
        self._drives = [
            CanDrive(
                plan,
                self._send,
                exchange,
                spec=spec,
                say=self._say,
            )
            for plan in plans
        ]
        self._by_identifier = {
            one: drive for drive in self._drives for one in drive.plan.identifiers
        }
        self._opened_s = 0.0
        self._frames = 0

    def stats(self) -> LineStats:
        """Implement `ports.Line.stats`. `exchanges` counts frames of the drives. There are no round
        trips: most frames come without a request."""
        return LineStats(
            exchanges=self._frames,
            cycles=self._cycles.count,
            reopened=self._reopened,
            errors=dict(self._bus.errors),
            cycle_hz=self._cycles.rate_hz,
            requested_hz=self.spec.cycle_hz,
            wire_limit_hz=wire_limit_hz(self.spec, [drive.plan for drive in self._drives]),
        )

    # --------------------------------------------------------------------------------- its CAN bus
    def _warn(self, text: str) -> None:
        self._say_all(EventKind.DRIVE_WARNING, f"{self.spec.name}: {text}")

    async def _open_wire(self) -> None:
        await self._bus.open()
        self._gate.opened()
        self._opened_s = now_s()

    def _close_medium(self) -> None:
        self._bus.close()

    def _take_frame(self, message: can.Message, stamp_ns: int) -> None:
        named = (message.arbitration_id, message.is_extended_id)
        drive = None if message.is_remote_frame else self._by_identifier.get(named)
        if drive is None:
            self._take_other(message)
            return
        found = drive.plan.parse(
            message.arbitration_id, bytes(message.data), extended=message.is_extended_id
        )
        if found is None:
            self._bus.errors["bad_frame"] += 1
            return
        self._frames += 1
        drive.receive(*found, stamp_ns)

    def _take_other(self, message: can.Message) -> None:
        """Take a frame of no drive: one of motord's that has left, or one of another node, which
        can move the drives if it sends what motord sends."""
        key = (message.arbitration_id, message.is_extended_id, message.is_remote_frame)
        sending = self._sendings.get(key)
        if sending is None:
            return
        if self._shows_own and self._own_frames.came(key, bytes(message.data)):
            if key[:2] in self._carry_setpoints:
                self._gate.left()
            return
        self._bus.errors["foreign"] += 1
        if warning := self._foreign_senders.new(sending, now_s()):
            self._warn(f"{self.spec.port}: {warning}")

    def _look(self) -> None:
        """Take in all received frames, before a drive counts as missing."""
        self._bus.catch_up()
        self._bus.check()

    def _send(self, sent: Sent) -> bool:
        taken = self._put(sent)
        self._gate.handed(taken=taken)
        return taken

    def _put(self, sent: Sent) -> bool:
        """Send a frame as `CanBus.send` does, and note it for when it comes back."""
        taken = self._bus.send(sent)
        if taken and self._shows_own:
            self._own_frames.sent(sent)
        return taken

    def _newest(self, drive: CanDrive) -> Wanted:
        """Implement `AsyncioLine._newest`."""
        return {} if self._gate.is_shut(now_s()) else super()._newest(drive)

    def _begins_early(self) -> bool:
        """Implement `AsyncioLine._begins_early`. Not while motion waits in the queue: with a pulled
        cable, an early cycle would queue more of it."""
        if self._gate.holds_motion:
            self._woken.clear()
            return False
        return super()._begins_early()

    async def _cycle(self) -> None:
        if self._gate.is_shut(now_s()):
            self._bus.errors["tx_full"] += 1
        for drive in self._drives:
            drive.cycle(self._wanted(drive))
        self._synchronise()
        self._gate.cycle_ended(now_s(), moving=any(drive.sent_motion for drive in self._drives))
        if now_s() > self._opened_s + STEADY_S:
            self._backoff.reset()

    async def _cycle_at_rest(self, drives: Sequence[CanDrive]) -> None:
        for drive in drives:
            drive.cycle({})
        self._synchronise()
        await asyncio.sleep(STOPPING_CYCLE_S)

    async def _switch_each_off(self, left: list[CanDrive]) -> None:
        """Implement `AsyncioLine._switch_each_off`."""
        await super()._switch_each_off(left)
        if left:
            self._synchronise()

    def _synchronise(self) -> None:
        """Send SYNC: all drives act now on their frames of this cycle. Raises PortError."""
        for sync in self._syncs:
            self._put(sync)
        for drive in self._drives:
            drive.synchronised()

    # ---------------------------------------------------------------------------------------- jobs
    async def read_register(self, joint: str, register: str) -> float:
        """Implement `ports.Line.read_register`; a register is a signal. If the drive sends it
        without a request, the next frame counts."""
        self._drive_of(joint).plan.readable(register)
        return await super().read_register(joint, register)

    def _limit_s(self, jobs: Sequence[Job]) -> float:
        """Return the time of the longest job, doubled: drives work independently, and one job may
        be ahead."""
        tries = max(drive.tries for drive in self._drives)
        return 2.0 * max((job.limit_s(self._period_s, tries) for job in jobs), default=0.0)
