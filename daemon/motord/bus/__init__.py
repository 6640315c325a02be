# SPDX-License-Identifier: Apache-2.0
"""Buses: they publish the state and take commands. No devices, no C core."""
