# SPDX-License-Identifier: Apache-2.0
"""A slow robot for tests of what a bus publishes and accepts."""

from tests.sim.daemon_stage import RETRIED

LOOP = "loop.rate_hz=100"
RATES = (LOOP, "line.rs485.cycle_hz=20")
"""Rates of the loop and the line. No bus of these tests publishes or commands at a higher rate. A
faster loop and line would take twice the CPU in each of the tests that run side by side."""
LIGHT = (*RETRIED, *RATES)
"""Settings of the demonstration robot: low rates, and repeated requests. Thus a reply that a busy
machine delays is not a fault."""
