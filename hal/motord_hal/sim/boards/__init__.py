# SPDX-License-Identifier: Apache-2.0
"""Simulated microcontroller boards."""
