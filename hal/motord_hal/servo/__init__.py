# SPDX-License-Identifier: Apache-2.0
"""Packets of bus servos, shared by the line, the simulator and the scan."""
