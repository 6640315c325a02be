# SPDX-License-Identifier: Apache-2.0
"""Simulated pins and bridges."""
