# SPDX-License-Identifier: Apache-2.0
"""The mode of a drive after every event in every mode, as tests/c/drive/drive_walk_table.h has it;
and lines in asyncio that a test brings into each mode."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import re
from pathlib import Path

from can_rig import TURN
from can_rig import spec_of as can_spec_of
from loop_side import GENEROUS_S, PATIENT_S, running, until
from modbus_rig import (
    CONTROL,
    ENABLE,
    MODE,
    OFF,
    RPM,
    TARGET_1,
    VELOCITY_1,
    WATCHDOG,
    hub_servo,
    registers_of,
)
from modbus_rig import spec_of as modbus_spec_of
from scripted_odrive import CLOSED_LOOP, IDLE, STATE, Peer, living
from scripted_slave import ScriptedSlave, Unit
from slcan_adapter import SlcanAdapter

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import HalError, NoReply
from motord_hal.fieldbus.ports import DriveState

TABLE = Path(__file__).parents[2] / "c/drive/drive_walk_table.h"
FROM = ("OFF", "READY", "ARMED", "STOPPING", "UNRESPONSIVE", "BACK")
MODES = {
    "OFF": DriveState.UNKNOWN,
    "READY": DriveState.READY,
    "ARMED": DriveState.ARMED,
    "UNRESPONSIVE": DriveState.UNRESPONSIVE,
}
CYCLES = 10
"""Number of cycles within which a line certainly reacts to an event."""
MEASURING = 2
"""Axis state of an ODrive that is neither idle nor in closed-loop control."""


def rows_of(kind):
    """Yield the words in the parentheses of each of the table's rows of this kind."""
    rows = rf"^{kind}\(((?s:.*?))\)$"
    for found in re.findall(rows, TABLE.read_text(encoding="utf-8"), re.MULTILINE):
        yield [word.strip() for word in found.split('"')[0].split(",") if word.strip()]


def cells(media):
    """Return event → mode before → mode after the event, for a drive of a line in asyncio. `media`:
    the names that the table has for that line."""
    leads = {event: dict(zip(FROM, modes, strict=True)) for event, *modes in rows_of("LEADS_TO")}
    for medium, event, begin, mode in rows_of("DIFFERS"):
        if medium in media:
            leads[event][begin] = mode
    for medium, event, begin in rows_of("CANNOT_OCCUR"):
        if medium in media:
            for one in leads if event == "ANY" else (event,):
                for start in FROM if begin == "ANY" else (begin,):
                    leads[one].pop(start, None)
    return {event: modes for event, modes in leads.items() if modes}


def _sets_up_again(begin, event):
    """Return whether the line sets the drive up by itself after this event."""
    return ["ASYNCIO", event, begin, "READY"] in rows_of("DIFFERS")


def _sends_power_off(begin, event):
    return [event, begin] in rows_of("SENDS_POWER_OFF")


def _patient(joint):
    """Return the joint with a set-up that waits patiently for the drive's answers."""
    steps = tuple(
        step if step.value is not None else dataclasses.replace(step, within_s=GENEROUS_S)
        for step in joint.profile.configure
    )
    return dataclasses.replace(joint, profile=dataclasses.replace(joint.profile, configure=steps))


class ModbusMedium:
    """A hub servo on a pty."""

    names = ("ASYNCIO",)

    def __init__(self, folder):
        self.peer = ScriptedSlave(folder / "port")
        self.unit = self.peer.units[1] = Unit(registers_of("zlac8015d"))
        joints = [_patient(joint) for joint in hub_servo()]
        self.spec = modbus_spec_of(self.peer, joints)
        self.velocity_rad_s = 60 * RPM
        self._holds = self._keeps_power = False
        self.unit.on_write = self._written

    @contextlib.asynccontextmanager
    async def life(self):
        try:
            yield
        finally:
            self.peer.pull()

    def _written(self, address, _):
        if address == MODE and self._holds:
            self.unit.registers[MODE] = 0
        elif address == CONTROL and self._keeps_power:
            self.unit.registers[CONTROL] = ENABLE

    def hold_set_up(self):
        self._holds = True

    def go_on_with_set_up(self):
        self._holds = False
        self.unit.registers[MODE] = 3

    def turn(self):
        self.unit.registers[VELOCITY_1] = 600

    def fall_silent(self):
        self.unit.silent = True

    def answer_again(self):
        self.unit.silent = False

    def disable_itself(self):
        self.unit.registers[CONTROL] = OFF

    def lose_setup(self):
        self.unit.registers[WATCHDOG] = 0

    def stay_enabled(self):
        self.unit.registers[CONTROL] = ENABLE
        self._keeps_power = True

    def lose(self):
        self.peer.pull()

    def motion_count(self):
        return sum(value != 0 for value in self.peer.written(TARGET_1))

    def power_off_count(self):
        return self.peer.written(CONTROL).count(OFF)

    def has_power_off(self):
        return self.peer.written(CONTROL)[-1] == OFF


class CanMedium:
    """An ODrive behind an slcan adapter on a pty."""

    names = ("ASYNCIO", "ASYNCIO_CAN")

    def __init__(self, folder):
        self.adapter = SlcanAdapter(folder / "adapter")
        self.peer = Peer("slcan", (0,), self.adapter.address, self.adapter)
        self.axis = self.peer.axes[0]
        spec = can_spec_of(self.peer, 0)
        joints = tuple(_patient(joint) for joint in spec.joints)
        self.spec = dataclasses.replace(spec, joints=joints)
        self.velocity_rad_s = TURN

    def life(self):
        return living(self.peer)

    def hold_set_up(self):
        self.axis.state, self.axis.stuck = MEASURING, True

    def go_on_with_set_up(self):
        self.axis.state, self.axis.stuck = IDLE, False

    def turn(self):
        self.axis.velocity_turns_s = 1.0

    def fall_silent(self):
        self.axis.silent = True

    def answer_again(self):
        self.axis.silent = False

    def disable_itself(self):
        self.axis.state = MEASURING if self.axis.stuck else IDLE

    def stay_enabled(self):
        self.axis.state, self.axis.stuck = CLOSED_LOOP, True

    def lose(self):
        self.adapter.pull()

    def motion_count(self):
        return sum(value != 0.0 for value in self.axis.velocities())

    def power_off_count(self):
        return self.axis.states().count(IDLE)

    def has_power_off(self):
        return int.from_bytes(self.axis.sent(STATE)[-1], "little") == IDLE


class Walk:
    """One cell of the table: brings a line into a mode, causes an event, checks its result."""

    def __init__(self, medium, rig):
        self.medium = medium
        self.rig = rig

    async def go(self, begin, event, mode):
        await self._to(begin)
        again = _sets_up_again(begin, event)
        if again:
            self.medium.hold_set_up()
        power_offs = self.medium.power_off_count()
        await getattr(self, f"_{event.lower()}")(mode)
        if _sends_power_off(begin, event):
            await until(
                lambda: self.medium.power_off_count() > power_offs + again,  # a set-up writes one
                f"{event} from {begin}: no power",
            )
        if again:
            await until(lambda: self.rig.states() == {MODES["OFF"]}, f"{event} from {begin}: OFF")
            self.medium.go_on_with_set_up()
        await until(lambda: self.rig.states() == {MODES[mode]}, f"{event} from {begin}: {mode}")
        motion = self.medium.motion_count()
        if mode == "ARMED":
            await until(lambda: self.medium.motion_count() > motion, f"{event} from {begin}: moves")
            return
        await self._cycles()
        assert self.rig.states() == {MODES[mode]}, (begin, event)
        assert self.medium.motion_count() == motion, (begin, event)

    async def _cycles(self):
        """Wait for CYCLES cycles, or until the line is closed or has ended."""
        before = self.rig.line.stats().cycles
        is_over = self.rig.task.done
        await until(
            lambda: self.rig.line.stats().cycles > before + CYCLES or self.rig.states()
            == {DriveState.UNKNOWN} or is_over()
        )  # fmt: skip

    async def _to(self, begin):
        rig = self.rig
        rig.loop.enabled, rig.loop.velocity_rad_s = True, {0: self.medium.velocity_rad_s}
        if begin == "OFF":
            await until(lambda: rig.line.stats().cycles > CYCLES)
            assert rig.states() == {DriveState.UNKNOWN}
            return
        self.medium.go_on_with_set_up()
        await rig.ready()
        if begin in ("ARMED", "STOPPING"):
            await rig.drive(self.medium.motion_count, "it is sent motion")
        if begin == "STOPPING":
            self.medium.turn()
            rig.loop.running = False
            await until(lambda: rig.line.is_stopping(rig.line.spec.joints[0].name))
            rig.loop.running = True
            await until(lambda: now_ns() - rig.loop.put_ns < PATIENT_S * 1e9)
        elif begin == "UNRESPONSIVE":
            await self._falls_silent("UNRESPONSIVE")
            await until(lambda: rig.states() == {DriveState.UNRESPONSIVE})

    async def _setpoints_old(self, _):
        self.rig.loop.running = False
        await until(lambda: now_ns() - self.rig.loop.put_ns > PATIENT_S * 1e9)
        await self._cycles()

    async def _setpoints_not_enabled(self, _):
        self.rig.loop.enabled = False
        self.rig.loop.put()
        await self._cycles()

    async def _requested_off(self, _):
        self.medium.lose()

    async def _requested_ready(self, _):
        self.medium.go_on_with_set_up()

    async def _requested_armed(self, mode):
        if mode == "ARMED" and self.rig.states() == {DriveState.READY}:
            await self.rig.arm()
            return
        if mode == "ARMED":
            await self.rig.line.arm()
            return
        try:
            await self.rig.line.arm()
        except HalError:
            return
        raise AssertionError("it was armed")

    async def _requested_stand_down(self, _):
        silent = DriveState.UNRESPONSIVE in self.rig.states()
        try:
            await self.rig.line.disarm()
        except NoReply:
            assert silent, "only a drive that does not answer leaves it unconfirmed"

    async def _falls_silent(self, _):
        self.medium.fall_silent()

    async def _answers_again(self, _):
        self.medium.answer_again()
        await self._cycles()

    async def _disabled_itself(self, _):
        self.medium.disable_itself()
        await self._cycles()

    async def _lost_setup(self, _):
        self.medium.lose_setup()
        await self._cycles()

    async def _still_enabled(self, _):
        self.medium.stay_enabled()
        await self._cycles()

    async def _line_ends(self, _):
        self.rig.task.cancel()
        await asyncio.wait([self.rig.task])
        await until(self.medium.has_power_off)


async def walk(make, folder, event, leads):
    """Run all cells of an event at once, each on a line of its own."""

    async def cell(begin, mode):
        place = folder / begin.lower()
        place.mkdir()
        medium = make(place)
        medium.hold_set_up()
        async with medium.life(), running(medium.spec) as rig:
            await Walk(medium, rig).go(begin, event, mode)

    async with asyncio.TaskGroup() as group:
        for begin, mode in leads.items():
            group.create_task(cell(begin, mode))
