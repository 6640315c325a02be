# SPDX-License-Identifier: Apache-2.0
"""Stopping a board whose program has ended: brake, then no power, sent again and again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from motord_hal.base.clock import now_ns, now_s
from motord_hal.drives.profile import Step
from motord_hal.fieldbus.halt import STOPPING_WITHIN_S
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.mcu.dialect import BoardFeedback, Dialect
from motord_hal.mcu.frame_dialect import FrameDialect
from motord_hal.mcu.link import Stream
from motord_hal.mcu.pace import period_s
from motord_hal.modbus.plan import DrivePlan

OFF_WITHIN_S = 0.3


class _Halt:
    def __init__(self, spec: LineSpec, dialect: Dialect) -> None:
        self._dialect = dialect
        self._rest_velocity_rad_s = spec.rest_velocity_rad_s
        self._plan = DrivePlan(spec.joints, 0.0, lambda _: 0.0)
        self._stream = Stream(spec, self._take_in)
        self._period_s = period_s(spec, dialect.wire_bytes())
        self._newest: BoardFeedback | None = None

    def _take_in(self, data: bytes) -> None:
        for newest in self._dialect.feed(data, now_ns()):
            self._newest = newest

    async def run(self) -> list[str]:
        profile = self._plan.profile
        self._stream.open()
        try:
            await self._say(profile.quick_stop, STOPPING_WITHIN_S, self._rests)
            off = await self._say(profile.disarm, OFF_WITHIN_S, self._is_off)
        finally:
            await asyncio.sleep(2 * self._period_s)  # until the last frame is on the wire
            self._stream.close()
        if off or not self._dialect.answers:
            return []
        names = ", ".join(joint.name for joint in self._plan.joints)
        what = "has sent nothing" if self._newest is None else "has not reported that it is off"
        return [f"the board of {names} {what}"]

    async def _say(
        self, steps: tuple[Step, ...], within_s: float, done: Callable[[int], bool]
    ) -> bool:
        """Zero set-points and what the steps write, until it is done; whether it came to that."""
        raw = {step.register: step.value for step in steps if step.value is not None}
        began_ns, until_s = now_ns(), now_s() + within_s
        while now_s() < until_s:
            self._stream.send(self._dialect.setpoints(self._image(raw), now_ns()))
            await asyncio.sleep(self._period_s)
            if done(began_ns):
                return True
        return False

    def _image(self, raw: Mapping[str, int]) -> dict[str, int]:
        return {**raw, **self._plan.setpoints({})}

    def _rests(self, since_ns: int) -> bool:
        newest = self._received_since(since_ns)
        if newest is None:
            return False
        readings = [self._plan.reading(joint, newest.values, {}) for joint in self._plan.joints]
        rest_rad_s = self._rest_velocity_rad_s
        return all(abs(reading.velocity_rad_s) < rest_rad_s for reading in readings)

    def _is_off(self, since_ns: int) -> bool:
        newest = self._received_since(since_ns)
        return newest is not None and self._plan.enabled(newest.values) is not True

    def _received_since(self, since_ns: int) -> BoardFeedback | None:
        newest = self._newest
        return newest if newest is not None and newest.received_ns >= since_ns else None


async def halt_board(spec: LineSpec, dialect: Dialect) -> list[str]:
    """Returns what was not acknowledged, in words. Raises PortError."""
    return await _Halt(spec, dialect).run()


async def halt_line(spec: LineSpec) -> list[str]:
    """As `halt_board`, for `kind = "mcu"`."""
    return await halt_board(spec, FrameDialect(spec))
