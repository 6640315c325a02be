# SPDX-License-Identifier: Apache-2.0
"""A process that loads the machine until it is killed or its parent has ended. Run it as a script
with `cpu|io|fifo|fork|faults PARENT_PID WHERE`. It prints one byte when it has begun. WHERE is the
folder to write to, or the processors to run on ("-": any)."""

import mmap
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable

BLOCK_BYTES = 1 << 20
BALLAST_BYTES = 256 << 20
"""Memory whose page tables each fork copies, or that the thread allocates and frees repeatedly."""
FIFO_PRIORITY = 90
BUSY_S, PAUSE_S = 0.003, 0.017
"""Times of the real-time process: it is busy for three periods of a loop at 1 kHz, 50 times a
second."""


def burn_cpu() -> None:
    total = 0
    for i in range(200_000):
        total += i * i


def burn_io(fd: int, block: bytes) -> None:
    os.pwrite(fd, block, 0)
    os.fsync(fd)


def hold_cpu() -> None:
    end_s = time.monotonic() + BUSY_S
    while time.monotonic() < end_s:
        pass
    time.sleep(PAUSE_S)


def fork_once() -> None:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)


def fault_in() -> None:
    with mmap.mmap(-1, BALLAST_BYTES) as memory:
        for place in range(0, BALLAST_BYTES, mmap.PAGESIZE):
            memory[place] = 1


def repeat(work: Callable[[], None], parent_pid: int) -> None:
    os.write(sys.stdout.fileno(), b".")
    while os.getppid() == parent_pid:
        work()


def culprit(kind: str, parent_pid: int, cpus: str) -> None:
    if cpus != "-":
        os.sched_setaffinity(0, {int(cpu) for cpu in cpus.split(",")})
    if kind == "fifo":
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
        repeat(hold_cpu, parent_pid)
    elif kind == "fork":
        ballast = bytearray(BALLAST_BYTES)
        for place in range(0, BALLAST_BYTES, mmap.PAGESIZE):
            ballast[place] = 1
        repeat(fork_once, parent_pid)
    else:
        thread = threading.Thread(target=repeat, args=(fault_in, parent_pid))
        thread.start()
        thread.join()


def main(kind: str, parent_pid: int, where: str) -> None:
    if kind == "cpu":
        repeat(burn_cpu, parent_pid)
    elif kind == "io":
        with tempfile.TemporaryFile(dir=where) as file:
            block = os.urandom(BLOCK_BYTES)
            repeat(lambda: burn_io(file.fileno(), block), parent_pid)
    else:
        culprit(kind, parent_pid, where)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
