# SPDX-License-Identifier: Apache-2.0
"""Modbus: the frames, and the RTU line."""
