# SPDX-License-Identifier: Apache-2.0
"""Task that reads the battery's measurement, again and again, and acts on it."""

from __future__ import annotations

import asyncio
import logging
import math
from pathlib import Path

from motord.base.log import about
from motord.config import DrivesBattery, InaBattery
from motord.control.battery import BatteryLevel, Measure, of_drives
from motord.control.operation import Operation
from motord_hal.base.clock import within
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.ports import Line
from motord_hal.i2c.bus import I2cDevice
from motord_hal.i2c.ina import Ina, Power
from motord_hal.realtime.exchange import now_ns

PERIOD_S = 0.5
REGISTER_WITHIN_S = 1.0
"""Deadline for one register of a drive to be read."""
READ_WITHIN_S = 4.0
"""Deadline for the chip: the kernel gives up on an I2C bus that is held after a second and some
tries."""

_log = logging.getLogger(__name__)


async def watch_battery(operation: Operation) -> None:
    """Watch the battery until cancelled. Without [battery], return at once."""
    section = operation.robot.battery
    if section is None:
        return
    chip = _Chip(section) if isinstance(section, InaBattery) else None
    readings = _Readings(operation, section) if isinstance(section, DrivesBattery) else None
    try:
        while True:
            if readings is not None:
                _take(operation, await readings.measure())
            elif chip is not None:
                _take(operation, await chip.measure())
            await asyncio.sleep(PERIOD_S)
    finally:
        if chip is not None:
            chip.close()


def _take(operation: Operation, measure: Measure | None) -> None:
    watch = operation.battery
    if watch is None:
        return
    message = watch.take(measure, now_ns())
    if message is not None:
        fine = watch.level is BatteryLevel.NORMAL
        level = logging.INFO if fine else logging.WARNING
        _log.log(level, "%s", message, extra=about(event=f"battery_{watch.level}"))
    if operation.battery_forbids:
        operation.fault("the battery is critical (safety.on_battery_critical)")


class _Readings:
    """Measurements from the drives' feedback and from the registers that the section names."""

    def __init__(self, operation: Operation, section: DrivesBattery) -> None:
        self._operation = operation
        self._section = section
        self._joints = tuple(operation.robot.joint)
        self._reported: dict[str, str] = {}

    async def measure(self) -> Measure:
        """Return a measurement. Registers of a silent drive are not read: this would only wait for
        it."""
        readings = {}
        for key, where in self._section.readings.items():
            joint = where.partition(".")[0]
            if not self._operation.snapshot.joints[self._joints.index(joint)].stale:
                readings[key] = await self._read(where)
        return of_drives(self._section, self._joints, self._operation.snapshot, readings)

    async def _read(self, where: str) -> float:
        """Return the register's value; NaN: it cannot be read now. A failure is logged once."""
        joint, _, register = where.partition(".")
        problem = ""
        try:
            async with within(REGISTER_WITHIN_S):
                value = await self._line_of(joint).read_register(joint, register)
        except LookupError as error:
            value, problem = math.nan, str(error.args[0])
        except (HalError, TimeoutError) as error:
            value, problem = math.nan, str(error) or "it took too long"
        if problem and problem != self._reported.get(where):
            text = f"battery: {where} was not read: {problem}"
            _log.warning("%s", text, extra=about(event="battery_sensor", joints=(joint,)))
        self._reported[where] = problem
        return value

    def _line_of(self, joint: str) -> Line:
        name = self._operation.robot.joint[joint].line
        return next(line for line in self._operation.lines if line.spec.name == name)


class _Chip:
    """The power monitor: opened at the first reading, and again after each failure. A failure is
    logged once."""

    def __init__(self, section: InaBattery) -> None:
        self._section = section
        self._open: Ina | None = None
        self._reported = ""
        self._in_progress: asyncio.Future[Power] | None = None

    async def measure(self) -> Measure | None:
        """Return a measurement; None: the chip cannot be read now."""
        if self._in_progress is None:
            # a thread: a device that holds the I2C bus blocks for seconds; the robot must not wait
            self._in_progress = asyncio.get_running_loop().run_in_executor(None, self._read)
        try:
            async with within(READ_WITHIN_S):
                power = await asyncio.shield(self._in_progress)
        except TimeoutError as error:
            if self._in_progress.done():  # the chip's own NoReply
                self._fail(error)
            return None  # still in the kernel: the same call is waited for again
        except HalError as error:
            self._fail(error)
            return None
        self._in_progress, self._reported = None, ""
        sign = 1.0 if self._section.inverted else -1.0
        return Measure(
            stamp_ns=now_ns(),
            voltage_v=power.voltage_v,
            current_a=sign * power.current_a if math.isfinite(power.current_a) else math.nan,
            temperature_c=power.chip_c if self._section.chip_at_pack else math.nan,
        )

    def _read(self) -> Power:
        if self._open is None:
            device = I2cDevice.open(Path(self._section.bus), self._section.address)
            try:
                self._open = Ina(self._section.source, device, self._section.shunt_ohm)
            except HalError:
                device.close()
                raise
        return self._open.read()

    def _fail(self, error: Exception) -> None:
        self._in_progress = None
        self.close()
        if str(error) != self._reported:
            self._reported = str(error)
            _log.warning("battery: %s", error, extra=about(event="battery_sensor"))

    def close(self) -> None:
        """Close the chip, unless a thread still uses it: then the end of the process closes it."""
        if self._open is not None and self._in_progress is None:
            self._open.close()
            self._open = None
