# SPDX-License-Identifier: Apache-2.0
"""The rule by which a stamp is fresh: one for the core, the lines in C and the lines in asyncio."""

import os
import subprocess
import sys

import pytest
from _motord_rt import ffi, lib

from motord.api.snapshot import stamp_is_fresh
from motord_hal.fieldbus.ports import SETPOINT_TIMEOUT_S
from motord_hal.realtime.exchange import is_fresh, now_ns

NOW_NS = 10_000_000_000
TIMEOUT_NS = round(SETPOINT_TIMEOUT_S * 1e9)
AHEAD_NS = 10_000_000
"""How much a stamp may be ahead: another thread may write it after the clock was read."""
CASES = {
    "made now": (NOW_NS, True),
    "as old as the timeout": (NOW_NS - TIMEOUT_NS, True),
    "older than the timeout": (NOW_NS - TIMEOUT_NS - 1, False),
    "from another thread, made meanwhile": (NOW_NS + AHEAD_NS, True),
    "of the future": (NOW_NS + AHEAD_NS + 1, False),
    "far in the future": (NOW_NS + 3600 * 10**9, False),
    "the last moment of the clock": (2**63 - 1, False),
    "never written": (0, False),
    "before the clock began": (-1, False),
    "the first moment of the clock": (-(2**63), False),
}


@pytest.mark.parametrize("case", CASES)
def test_the_rule_accepts_stamps_that_are_neither_old_nor_from_the_future(case):
    stamp_ns, wanted = CASES[case]
    assert bool(lib.stamp_is_fresh(NOW_NS, stamp_ns, TIMEOUT_NS)) is wanted


@pytest.mark.parametrize("case", CASES)
def test_programs_that_read_the_state_page_judge_by_this_rule(case):
    stamp_ns, wanted = CASES[case]
    assert stamp_is_fresh(NOW_NS, stamp_ns, SETPOINT_TIMEOUT_S) is wanted


@pytest.mark.parametrize("case", CASES)
def test_a_bridge_moves_by_this_rule(case):
    stamp_ns, wanted = CASES[case]
    config = ffi.new("bridge_config *")
    config.setpoint_timeout_ns = TIMEOUT_NS
    config.joint_count = config.output_count = 1
    config.joint[0].sign = 1.0
    config.output[0].slope = (0.0, 0.0, 1.0, 1.0)
    control = ffi.new("bridge_control *", {"mode": lib.PWM_ARMED, "number": 1})
    newest = ffi.new("setpoints *", {"stamp_ns": stamp_ns, "enabled": 1, "joint_count": 1})
    newest.joint[0].duty = 0.5
    level = ffi.new("double[32]")
    lib.bridge_step(ffi.new("bridge_state *"), config, control, newest, NOW_NS, level)
    assert (level[0] != 0.0) is wanted


def test_a_line_in_asyncio_moves_by_this_rule():
    timeout_s = TIMEOUT_NS * 1e-9
    assert is_fresh(now_ns(), timeout_s)
    assert not is_fresh(now_ns() + 60 * 10**9, timeout_s)
    assert not is_fresh(now_ns() - TIMEOUT_NS - 1, timeout_s)
    assert not any(is_fresh(stamp_ns, timeout_s) for stamp_ns in (0, -1, 2**63 - 1, -(2**63)))


CLOCK_C = """
#define _GNU_SOURCE
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
long slept_s;
int clock_gettime(clockid_t clock, struct timespec *out)
{
    long failed = syscall(SYS_clock_gettime, clock, out);
    out->tv_sec += failed == 0 && clock == CLOCK_BOOTTIME ? slept_s : 0;
    return (int)failed;
}
"""
"""Replaces clock_gettime of the C library: CLOCK_MONOTONIC seems to have stood for `slept_s`."""
PROGRAM = """
import ctypes
from motord_hal.realtime.exchange import is_fresh, now_ns
slept_s = ctypes.c_long.in_dll(ctypes.CDLL(None), "slept_s")
before_ns = now_ns()
assert is_fresh(before_ns, 0.1)
slept_s.value = 3600
assert not is_fresh(before_ns, 0.1)
assert is_fresh(now_ns(), 0.1)
assert not is_fresh(before_ns, 0.1)
"""


def test_for_a_line_in_asyncio_nothing_from_before_a_suspend_is_fresh(tmp_path):
    source, shared = tmp_path / "clock.c", tmp_path / "clock.so"
    source.write_text(CLOCK_C, encoding="utf-8")
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", shared, source], check=True)
    environment = {**os.environ, "LD_PRELOAD": str(shared)}
    subprocess.run([sys.executable, "-c", PROGRAM], env=environment, check=True)
