# SPDX-License-Identifier: Apache-2.0
"""A robot for tests that are about what a bus brings and takes."""

from tests.sim.daemon_stage import RETRIED

LOOP = "loop.rate_hz=100"
RATES = (LOOP, "line.rs485.cycle_hz=20")
"""No bus sends or obeys more often, and a faster loop and line would take twice the CPU in each of
the tests that run side by side."""
LIGHT = (*RETRIED, *RATES)
"""The demonstration's robot; a busy machine that delays a reply is no fault to it."""
