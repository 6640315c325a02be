# SPDX-License-Identifier: Apache-2.0
"""Simulated drives on RS485 and TCP."""
