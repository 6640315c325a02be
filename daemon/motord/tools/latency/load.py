# SPDX-License-Identifier: Apache-2.0
"""Loads for the machine while it is measured. All of them end with their block."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

from motord.base.python_command import script_command

LOADS = ("none", "cpu", "io", "gil", "fifo", "fork", "faults")
CULPRITS = ("fifo", "fork", "faults")
"""Loads of one process that delays the loop in a known manner, to try --suspects."""
BURNER = Path(__file__).with_name("burner.py")
IO_PROCESSES = 2
START_DEADLINE_S = 20.0
# /var/tmp first: /tmp is in memory on many systems, where fsync does nothing.
DISK_DIRECTORIES = ("/var/tmp", "/tmp")  # noqa: S108 private folders are made in it


class LoadError(Exception):
    """The load could not be started."""


@contextlib.contextmanager
def load(kind: str, cpu: tuple[int, ...] = ()) -> Iterator[None]:
    """Load the machine in this block. Kinds: `cpu`: one process for each processor computes; `io`:
    processes write and fsync; `gil`: a thread of this process never waits; `fifo`: a real-time
    process above the loop; `fork`: a process starts processes; `faults`: a thread of a process
    allocates and frees memory; `none`. The processors `cpu` (empty: any) are for `fifo`, `fork` and
    `faults`. The load is on when the block begins. Raise LoadError if it does not start."""
    with contextlib.ExitStack() as cleanup:
        if kind in CULPRITS:
            burn(cleanup, kind, 1, ",".join(map(str, cpu)) or "-")
        elif kind == "cpu":
            burn(cleanup, "cpu", len(os.sched_getaffinity(0)), "-")
        elif kind == "io":
            folder = tempfile.TemporaryDirectory(prefix="motord-latency-", dir=disk_directory())
            burn(cleanup, "io", IO_PROCESSES, cleanup.enter_context(folder))
        elif kind == "gil":
            cleanup.enter_context(gil_hog())
        elif kind != "none":
            raise ValueError(f"load is one of {', '.join(LOADS)}, not {kind!r}")
        yield


def disk_directory() -> str | None:
    """Return the folder to write to; None: the default of `tempfile`."""
    return next((d for d in DISK_DIRECTORIES if os.access(d, os.W_OK | os.X_OK)), None)


def burn(cleanup: contextlib.ExitStack, kind: str, count: int, where: str) -> None:
    """Start `count` burners. `where` is the folder to write to, or the processors. They have their
    own sessions, so that Ctrl-C goes only to the measurement, which then ends them."""
    processes = []
    for _ in range(count):
        process = subprocess.Popen(
            script_command(BURNER, kind, str(os.getpid()), where),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        cleanup.callback(end, process)
        processes.append(process)
    for process in processes:
        wait_for_first_byte(process)


def wait_for_first_byte(process: subprocess.Popen[bytes]) -> None:
    """Wait until the burner reports that it has begun. Raise LoadError if it does not."""
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], START_DEADLINE_S)
    if not ready or not process.stdout.read(1):
        raise LoadError(
            f"the process for the load did not start within {START_DEADLINE_S:.0f} s, or the "
            "kernel refused what it needs (--load fifo needs SCHED_FIFO 90: root, or rtprio)"
        )


def end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


@contextlib.contextmanager
def gil_hog() -> Iterator[None]:
    """Run a thread in this block that computes in Python and never releases the GIL by itself."""
    stop = threading.Event()

    def hog() -> None:
        total = 0
        while not stop.is_set():
            for i in range(1000):
                total += i * i

    thread = threading.Thread(target=hog, name="latency-gil-hog", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
