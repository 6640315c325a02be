# SPDX-License-Identifier: Apache-2.0
"""The load of `motord latency` works while its block runs, and is gone afterwards."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from motord.tools.latency.load import BURNER, IO_PROCESSES, load

DEADLINE_S = 30.0
COUNTS = {"cpu": len(os.sched_getaffinity(0)), "io": IO_PROCESSES}


PARENT = """
import time
from motord.tools.latency.load import load
with load("cpu"):
    print("on", flush=True)
    time.sleep(60)
"""


def burners(parent_pid=None):
    """Return the process numbers of a process's burners, found as `ps` finds them."""
    wanted = str(os.getpid() if parent_pid is None else parent_pid)
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except (FileNotFoundError, ProcessLookupError):
            continue
        if str(BURNER) in words and wanted in words:
            found.append(int(path.parent.name))
    return found


def wait_until(condition, what):
    end = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.02)


def hogs():
    return [thread for thread in threading.enumerate() if thread.name == "latency-gil-hog"]


def cpu_ticks(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return int(fields[11])


def written_bytes(pid):
    return int(Path(f"/proc/{pid}/io").read_text().split("wchar:")[1].split()[0])


@pytest.mark.parametrize(("kind", "work"), [("cpu", cpu_ticks), ("io", written_bytes)])
def test_processes_work_while_the_block_runs_and_are_gone_after_it(kind, work):
    with load(kind):
        pids = burners()
        assert len(pids) == COUNTS[kind]
        before = {pid: work(pid) for pid in pids}
        wait_until(lambda: all(work(pid) > before[pid] for pid in pids), f"{kind} does nothing")
    assert burners() == []


def test_a_thread_holds_the_gil_while_the_block_runs_and_is_gone_after_it():
    with load("gil"):
        assert len(hogs()) == 1
        assert burners() == []
    assert hogs() == []


@pytest.mark.parametrize("kind", ["cpu", "io", "gil"])
def test_an_error_in_the_block_ends_the_load_as_well(kind):
    with pytest.raises(ZeroDivisionError), load(kind):
        assert burners() or hogs()
        raise ZeroDivisionError
    assert burners() == []
    assert hogs() == []


def test_no_load_starts_nothing():
    with load("none"):
        assert burners() == []
        assert hogs() == []


def test_an_unknown_load_is_refused():
    with pytest.raises(ValueError, match="cpu"), load("coffee"):
        pass


def test_a_killed_parent_takes_its_load_with_it():
    root = Path(__file__).resolve().parents[3]
    environment = {**os.environ, "PYTHONPATH": f"{root / 'daemon'}:{root / 'hal'}:{root}"}
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, env=environment
    ) as parent:
        assert parent.stdout.readline() == b"on\n"
        assert burners(parent.pid)
        parent.send_signal(signal.SIGKILL)
    wait_until(lambda: not burners(parent.pid), "the load outlived its parent")
