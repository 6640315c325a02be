# SPDX-License-Identifier: Apache-2.0
"""Threads between DDS and the daemon have real-time priority, and lose it when they are flooded."""

import json
import os
import subprocess
import sys

import pytest

CHILD = """
import asyncio, hashlib, json, os, sys, threading
from pathlib import Path
from motord.bus.confine import REALTIME_PRIORITY_MAX as PRIORITY, limit_realtime
from motord.bus.ros2.dds.priority import before_python

def granted():
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
    return True

named, flooded = threading.Event(), threading.Event()

def receive():
    Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text("recv")
    named.set()
    flooded.wait()
    hashlib.pbkdf2_hmac("sha256", b"", b"", int(sys.argv[1]))  # without the GIL

def policy(thread):
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK

async def main():
    thread = threading.Thread(target=receive, daemon=True)
    other = threading.Thread(target=flooded.wait, daemon=True)
    thread.start()
    other.start()
    named.wait()
    limit_realtime()
    before_python()
    threads = {"recv": thread.native_id, "other": other.native_id, "main": os.getpid()}
    found = {"granted": granted(), "policies": {k: policy(v) for k, v in threads.items()}}
    flooded.set()
    while thread.is_alive() and policy(thread.native_id) == os.SCHED_FIFO:
        await asyncio.sleep(0)  # the signal's handler runs
    print(json.dumps(found | {"runs_on": thread.is_alive()}), flush=True)
    os._exit(0)

asyncio.run(main())
"""
LONG, SHORT = 50_000_000, 1


def ran(iterations):
    """Run the child; return its findings and its log."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(iterations)],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    if not found["granted"]:
        pytest.skip("needs the right to SCHED_FIFO")
    return found, done.stderr


def test_only_receiving_threads_get_real_time_priority():
    found, _ = ran(SHORT)
    inherited = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    policies = {"recv": os.SCHED_FIFO, "other": inherited, "main": inherited}
    assert found["policies"] == policies


def test_a_thread_that_never_pauses_loses_its_real_time_priority():
    found, log = ran(LONG)
    assert found["runs_on"]
    assert "ran for 50 ms without a pause" in log
