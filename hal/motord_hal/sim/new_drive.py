# SPDX-License-Identifier: Apache-2.0
"""The simulated drive that speaks as a profile describes."""

from __future__ import annotations

from collections.abc import Mapping

from motord_hal.drives.profile import DriveProfile
from motord_hal.servo.packets import KINDS as SERVO_KINDS
from motord_hal.sim.axis import Axis
from motord_hal.sim.can.cia402 import Cia402Drive, speaks_cia402
from motord_hal.sim.pins.bridge import SimulatedBridge
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.servo import SimulatedServo


def new_drive(
    profile: DriveProfile, unit: int, axes: Mapping[int, Axis], *, watchdog_s: float
) -> SimulatedDrive:
    """Return a new drive of this profile."""
    kind = Cia402Drive if speaks_cia402(profile) else SimulatedDrive
    kind = SimulatedBridge if profile.bridge is not None else kind
    kind = SimulatedServo if profile.protocol in SERVO_KINDS else kind
    return kind(profile, unit, axes, watchdog_s=watchdog_s)
