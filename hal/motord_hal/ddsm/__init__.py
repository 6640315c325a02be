# SPDX-License-Identifier: Apache-2.0
"""Direct-drive hub motors with ten-byte frames on RS485, not Modbus."""
