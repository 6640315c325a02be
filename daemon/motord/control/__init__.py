# SPDX-License-Identifier: Apache-2.0
"""Control of the robot: state machine, leases, battery, and the settings of core, loop and
lines."""
