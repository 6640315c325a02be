# SPDX-License-Identifier: Apache-2.0
"""Simulated drives on CAN."""
