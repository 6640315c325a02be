# SPDX-License-Identifier: Apache-2.0
"""Buses, which publish the state and take commands. They have no devices and no C core."""
