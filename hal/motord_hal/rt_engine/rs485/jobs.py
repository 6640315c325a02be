# SPDX-License-Identifier: Apache-2.0
"""Jobs of a drive: sequences of steps, sent as requests in the acyclic slots of its line."""

from __future__ import annotations

from collections.abc import Sequence

from motord_hal.base.clock import now_s
from motord_hal.base.errors import BadReply, DriveFault, NoReply, Refused
from motord_hal.drives.profile import Step
from motord_hal.realtime.table import LineFrame
from motord_hal.rt_engine.rs485.frames import DriveFrames
from motord_hal.rt_engine.rs485.request_queue import Check, RequestQueue, always


class DriveJobs:
    """Runs the jobs of drive number `index` of the line's table, one request at a time."""

    def __init__(self, index: int, frames: DriveFrames, queue: RequestQueue) -> None:
        self.frames = frames
        self.profile = frames.profile
        self.joints = frames.joints
        self.unit = frames.unit
        self.tries = max(joint.tries for joint in frames.joints)
        self._index = index
        self._queue = queue
        self._name = ", ".join(joint.name for joint in frames.joints)

    @property
    def request_limit_s(self) -> float:
        """Longest time until a request is sent or dropped."""
        return self._queue.limit_s

    async def run(
        self,
        name: str,
        steps: Sequence[Step],
        *,
        urgent: bool = False,
        check: Check = always,
    ) -> int:
        """Do the steps in order; call `check` right before each request. An urgent job is a
        stop: it goes on after a refused write. Return the raw value that the newest wait has
        read. Raise HalError if a step fails."""
        refused: Refused | None = None
        raw = 0
        for step in steps:
            if step.value is None:
                raw = await self._wait_for(name, step, check)
                continue
            value = await self._copied(step, check) if step.copy_of else step.value
            if step.if_different and await self.read(step.register, check=check) == value:
                continue
            for frame in self.frames.writes({step.register: value}):
                try:
                    await self.send(frame, urgent=urgent, check=check)
                except Refused as error:
                    if not urgent:
                        raise
                    refused = refused or error
        if refused is not None:
            raise refused
        return raw

    async def _copied(self, step: Step, check: Check) -> int:
        registers = self.profile.registers
        raw = await self.read(step.copy_of, check=check)
        return registers[step.register].from_si(registers[step.copy_of].to_si(raw))

    async def _wait_for(self, name: str, step: Step, check: Check) -> int:
        give_up_s = None
        while True:
            raw = await self.read(step.register, check=check)
            if raw & step.mask == step.equals:
                return raw
            give_up_s = give_up_s or now_s() + step.within_s
            if now_s() > give_up_s:
                raise DriveFault(
                    f"{self._name} (unit {self.frames.unit}): {name}: {step.register} is {raw:#x} "
                    f"after {step.within_s:g} s, not {step.equals or 0:#x}"
                )

    async def read(self, register: str, *, check: Check = always) -> int:
        """Read a register now; return its raw value. Raise HalError if it cannot be read."""
        reply = await self.send(self.frames.read(register), check=check)
        return self.frames.raw(register, reply)

    async def send(self, frame: LineFrame, *, urgent: bool = False, check: Check = always) -> bytes:
        """Send a request, up to `tries` times if there is no good reply. Return the reply, or raise
        HalError."""
        turnaround_s = self.frames.profile.turnaround_s
        tries = 1
        while True:
            try:
                return await self._queue.send(
                    self._index, frame, turnaround_s, urgent=urgent, check=check
                )
            except (NoReply, BadReply):
                if tries == self.tries:
                    raise
            tries += 1
