# SPDX-License-Identifier: Apache-2.0
"""Task that keeps the thread running that reads the inertial sensor, and logs what changes."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from pathlib import Path

from motord.base.log import about
from motord.config import ChipImu
from motord.control.operation import Operation
from motord_hal.base.errors import HalError
from motord_hal.base.retry import Backoff
from motord_hal.base.tasks import TaskGroup
from motord_hal.fieldbus.ports import Mounting
from motord_hal.i2c.bus import I2cDevice
from motord_hal.i2c.imu import CHIPS
from motord_hal.i2c.imu_reader import ImuReader, ImuSpec
from motord_hal.realtime.exchange import Exchange

REOPEN_FIRST_S = 0.2
REOPEN_LIMIT_S = 5.0
FIRST_LOOK_S = 2.0
"""Time by which a sensor, or a board, has been opened and set up."""
LOOK_EVERY_S = 0.2

_log = logging.getLogger(__name__)

_TEXTS = {
    None: "the imu sends nothing",
    "unbiased": "the gyro sends samples; its zero is known once the base has stood still",
    "used": "the heading follows the gyro (its zero is at {:.5f} rad/s)",
    "stale": "the gyro sends nothing any more: the heading follows the wheels",
    "reversed": (
        "the gyro turns against the wheels, so it is not used any more: look at up in [imu], and "
        "at inverted and side of the joints"
    ),
}


async def watch_imu(operation: Operation) -> None:
    """Read and watch the sensor until cancelled. Without [imu], return at once; a board's sensor is
    read by its line."""
    if operation.robot.imu is None:
        return
    async with TaskGroup() as tasks:
        tasks.create_task(_say(operation))
        if isinstance(operation.robot.imu, ChipImu):
            tasks.create_task(_read(operation.robot.imu))


async def _say(operation: Operation) -> None:
    """Log each change of state once."""
    state: str | None = ""
    await asyncio.sleep(FIRST_LOOK_S)
    while True:
        imu = operation.snapshot.imu
        now = imu.state if imu else None
        if now != state:
            state = now
            level = logging.WARNING if now in (None, "stale", "reversed") else logging.INFO
            text = _TEXTS.get(now, f"the gyro is {now}")
            _log.log(level, text.format(imu.bias_rad_s if imu else 0.0), extra=about(event="imu"))
        await asyncio.sleep(LOOK_EVERY_S)


async def _read(section: ChipImu) -> None:
    address = section.address or CHIPS[section.source][0].default_address
    spec = ImuSpec(
        kind=section.source,
        rate_hz=section.rate_hz,
        range_rad_s=section.range_rad_s,
        mounting=Mounting(up=section.up, forward=section.forward),
    )
    opening = partial(I2cDevice.open, Path(section.bus), address)
    reader = ImuReader(spec, opening, Exchange.of_loop())
    backoff, reported, samples = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S), "", 0
    try:
        while True:
            try:
                await asyncio.get_running_loop().run_in_executor(None, reader.run)
            except HalError as error:
                if reader.samples > samples:  # it had worked meanwhile
                    backoff.reset()
                    reported, samples = "", reader.samples
                if str(error) != reported:
                    reported = str(error)
                    _log.warning("imu: %s", error, extra=about(event="imu_sensor"))
            await asyncio.sleep(backoff.next_s())
    finally:
        reader.stop()
