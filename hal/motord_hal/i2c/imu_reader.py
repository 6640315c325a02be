# SPDX-License-Identifier: Apache-2.0
"""Reads a chip at an even rate in its own thread. A device that holds the I2C bus blocks for
seconds, and neither asyncio nor the real-time loop may wait for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from motord_hal.base.clock import now_ns
from motord_hal.base.errors import BadReply, NoReply
from motord_hal.fieldbus.ports import Mounting
from motord_hal.i2c.bus import ByteRegisters
from motord_hal.i2c.imu import ImuChip
from motord_hal.realtime.exchange import Exchange

LATE_NS = 20_000_000
"""Limit for a transfer, which takes some 0.5 ms. The time of a sample that took longer is
unknown."""
LATE_MAX = 50
"""Number of late samples in a row after which the I2C bus is too slow or held, and the machine not
just busy."""
TRIES = 3
"""Number of failed reads in a row after which the chip is given up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSpec:
    """A chip, and its settings."""

    kind: str
    """Key of motord_hal.i2c.imu.CHIPS."""
    rate_hz: float
    range_rad_s: float
    mounting: Mounting


class ImuReader:
    """Reader whose `run` is the thread. It alone may write samples to the loop's mailbox."""

    def __init__(
        self, spec: ImuSpec, open_device: Callable[[], ByteRegisters], exchange: Exchange
    ) -> None:
        self._spec = spec
        self._open_device = open_device
        self._exchange = exchange
        self._stopped = threading.Event()
        self._epoch = 0
        self.samples = 0
        """Number of samples handed on so far."""
        self._late = 0

    def stop(self) -> None:
        """Make `run` return after the transfer in progress. Any thread may call this."""
        self._stopped.set()

    def run(self) -> None:
        """Open the chip, set it up and read it until `stop`. Raises HalError if it ends earlier;
        then it may be run again."""
        spec, device = self._spec, self._open_device()
        try:
            chip = ImuChip(
                spec.kind, device, rate_hz=spec.rate_hz, range_rad_s=spec.range_rad_s,
                sleep=self._pause,
            )  # fmt: skip
            self._epoch += 1
            self._read_on(chip)
        finally:
            device.close()

    def _pause(self, seconds: float) -> None:
        self._stopped.wait(seconds)

    def _read_on(self, chip: ImuChip) -> None:
        period_ns = round(1e9 / self._spec.rate_hz)
        due_ns, failed = now_ns(), 0
        while not self._stopped.is_set():
            try:
                self._read(chip)
                failed = 0
            except NoReply:
                failed += 1
                if failed >= TRIES:
                    raise
            due_ns = max(due_ns + period_ns, now_ns())
            self._pause((due_ns - now_ns()) * 1e-9)

    def _read(self, chip: ImuChip) -> None:
        began_ns = now_ns()
        motion = chip.read()
        if now_ns() - began_ns > LATE_NS:
            self._late += 1
            if self._late >= LATE_MAX:
                self._late = 0
                raise BadReply(f"{LATE_MAX} transfers in a row took more than {LATE_NS / 1e6:g} ms")
            return
        self._late = 0
        mounting = self._spec.mounting
        self._exchange.put_imu(
            stamp_ns=began_ns,
            angular_rad_s=mounting.to_base(motion.angular_rad_s),
            acceleration_m_s2=mounting.to_base(motion.acceleration_m_s2),
            saturated=motion.saturated,
            epoch=self._epoch,
        )
        self.samples += 1
