# SPDX-License-Identifier: Apache-2.0
"""Direct-drive hub motors that speak ten-byte frames on RS485, not Modbus."""
