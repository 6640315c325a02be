# SPDX-License-Identifier: Apache-2.0
"""Line of Modbus drives behind a gateway in the network: line.py over another medium."""

from __future__ import annotations

from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.guard import GuardedClient
from motord_hal.modbus.line import ModbusRtuLine
from motord_hal.modbus.tcp_guard import GatewayClient


class GatewayLine(ModbusRtuLine):
    """`ports.Line` for the kinds "modbus-tcp" and "rtu-over-tcp"."""

    def _new_client(self, spec: LineSpec) -> GuardedClient:
        return GatewayClient(spec)
