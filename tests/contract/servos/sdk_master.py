# SPDX-License-Identifier: Apache-2.0
"""A maker's SDK as the master of simulated servos."""

import contextlib
import time

from loop_side import GENEROUS_S

BAUDRATE = 1_000_000
OK = 0


def patiently(call):
    """Repeat an SDK's call until it succeeds: an SDK waits only some milliseconds for a reply."""
    end_s = time.monotonic() + GENEROUS_S
    while True:
        result = call()
        if result[-2] == OK or time.monotonic() > end_s:
            assert result[-2] == OK
            return result


def wait_until(condition):
    end_s = time.monotonic() + GENEROUS_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


@contextlib.contextmanager
def opened(port, path):
    port.setPortName(str(path))
    assert port.setBaudRate(BAUDRATE)
    try:
        yield port
    finally:
        port.closePort()
