# SPDX-License-Identifier: Apache-2.0
"""RoboClaws on a serial port: the line of motord_hal.modbus with packets instead of frames."""

from __future__ import annotations

from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import DriveState, LineSpec
from motord_hal.modbus.guard import GuardedClient
from motord_hal.modbus.line import ModbusRtuLine
from motord_hal.modbus.timing import line_gap_s
from motord_hal.roboclaw.client import RoboclawClient


class RoboclawLine(ModbusRtuLine):
    """ports.Line for `kind = "roboclaw"`, engine "asyncio"."""

    def _new_client(self, spec: LineSpec) -> GuardedClient:
        for joint in spec.joints:
            if joint.profile.protocol != "roboclaw":
                speaks = f"{joint.profile.name} speaks {joint.profile.protocol}"
                raise ProfileError(f"{spec.name}: {joint.name}: {speaks}, not roboclaw")
        return RoboclawClient(spec, line_gap_s(spec), self._holds)

    def _holds(self, unit: int) -> bool:
        """Whether a speed of zero shall hold the wheels: otherwise they are let go, so that a
        disarmed controller regulates nothing."""
        return any(
            drive.state is DriveState.ARMED or drive.is_stopping
            for drive in self._drives
            if drive.plan.unit == unit
        )
