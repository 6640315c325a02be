# SPDX-License-Identifier: Apache-2.0
"""Repeats tests that fail on a late machine: deadlines are valid only while every process gets its
time. During each test a thread measures this. A test that fails while the machine was late is run
again, at most three times, as long as its runs together took at most AGAIN_MAX_S; the summary names
it and the measured figures. A test that fails on a machine in time, or does not end, has failed.
Before the next run the machine gets some time to become less busy: an immediate run makes it
busier, and then another test fails. For the same reason a test begins only once the machine has
room for it.
"""

import os
import random
import threading
import time

import pytest
from _pytest.runner import runtestprotocol

LOOK_EVERY_S = 0.05
LATE_S = 0.05
"""The machine is late if a thread wakes later than this."""
CROWD = 2.0
"""The machine is late if it has more runnable processes for each processor than this on average."""
RUNS_MAX = 4
AGAIN_MAX_S = 130.0
ROOM_LOOK_S, ROOM_WITHIN_S = 0.05, 10.0
"""How often a test that waits for room looks, and the longest wait: the others go on meanwhile."""
CALM_LOOK_S, CALM_WITHIN_S = 0.5, 10.0
"""How long the machine must be in time before the next run, and the longest wait for that."""
CPUS = os.cpu_count() or 1
_PAUSES = random.Random()  # the tests' own numbers depend on the seed alone
_NAME = "late machine"
_LOAD_FD = os.open("/proc/loadavg", os.O_RDONLY | os.O_CLOEXEC)
"""Open descriptor of /proc/loadavg; never closed, because some tests use up all descriptors."""


class Watch:
    """A context manager that measures how late the machine is during its block."""

    def __init__(self):
        self.late_s = 0.0
        self.waiting = self.looks = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()

    def _look(self):
        began_s = time.monotonic()
        while not self._over.wait(LOOK_EVERY_S):
            now_s = time.monotonic()
            self.late_s = max(self.late_s, now_s - began_s - LOOK_EVERY_S)
            self.waiting += runnable()
            self.looks += 1
            began_s = time.monotonic()

    @property
    def crowd(self):
        """Runnable processes for each processor, without the measuring thread."""
        return self.waiting / max(self.looks, 1) / CPUS

    @property
    def why(self):
        """The measured figures if the machine was late; otherwise empty."""
        if self.late_s <= LATE_S and self.crowd <= CROWD:
            return ""
        return f"a thread woke {self.late_s:.2f} s late, {self.crowd:.1f} processes a processor"


def runnable():
    """Return the number of other runnable processes: proc(5), /proc/loadavg, the fourth field."""
    return int(os.pread(_LOAD_FD, 100, 0).split()[3].partition(b"/")[0]) - 1


def wait_for_room():
    """Wait until the machine is not crowded, at most ROOM_WITHIN_S."""
    end_s = time.monotonic() + ROOM_WITHIN_S
    while runnable() > CROWD * CPUS and time.monotonic() < end_s:
        time.sleep(ROOM_LOOK_S * _PAUSES.uniform(0.5, 1.5))  # not all at once


def calm_down():
    """Wait until the machine is in time again, at most CALM_WITHIN_S."""
    end_s = time.monotonic() + CALM_WITHIN_S
    late = True
    while late and time.monotonic() < end_s:
        with Watch() as watch:
            time.sleep(CALM_LOOK_S)
        late = bool(watch.why)


def hung(report):
    """Return whether pytest-timeout ended the test. It is not run again: no machine is late for so
    long, and a new run takes as long."""
    return "Failed: Timeout" in report.longreprtext


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    took_s = 0.0
    wait_for_room()
    for run in range(1, RUNS_MAX + 1):
        began_s = time.monotonic()
        with Watch() as watch:
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        failed = [report for report in reports if report.failed and report.when == "call"]
        if not failed or run == RUNS_MAX or not watch.why or any(map(hung, failed)):
            break
        took_s += time.monotonic() - began_s
        if took_s > AGAIN_MAX_S:
            break
        item.user_properties.append((_NAME, watch.why))
        calm_down()
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter):
    rows = [
        f"{report.nodeid}: {value}"
        for reports in terminalreporter.stats.values()
        for report in reports
        if getattr(report, "when", "") == "call"
        for name, value in report.user_properties
        if name == _NAME
    ]
    if rows:
        terminalreporter.section("run again: the machine was late")
        for row in rows:
            terminalreporter.write_line(row)
