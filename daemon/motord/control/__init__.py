# SPDX-License-Identifier: Apache-2.0
"""The daemon: state machine, leases, and what runs beside the loop."""
