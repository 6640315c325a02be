# SPDX-License-Identifier: Apache-2.0
"""RS485 lines: Modbus RTU, DDSM and RoboClaw."""
