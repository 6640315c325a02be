# SPDX-License-Identifier: Apache-2.0
"""Sensors on I2C, by the kernel's /dev/i2c-N."""
