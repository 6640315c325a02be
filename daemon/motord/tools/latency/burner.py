# SPDX-License-Identifier: Apache-2.0
"""A process that loads the machine until it is killed or its parent is gone: run as a script with
`cpu|io PARENT_PID FOLDER`. Prints one byte when it is at work."""

import os
import sys
import tempfile

BLOCK_BYTES = 1 << 20


def burn_cpu() -> None:
    total = 0
    for i in range(200_000):
        total += i * i


def burn_io(fd: int, block: bytes) -> None:
    os.pwrite(fd, block, 0)
    os.fsync(fd)


def main(kind: str, parent_pid: int, folder: str) -> None:
    os.write(sys.stdout.fileno(), b".")
    if kind == "cpu":
        while os.getppid() == parent_pid:
            burn_cpu()
        return
    with tempfile.TemporaryFile(dir=folder) as file:
        block = os.urandom(BLOCK_BYTES)
        while os.getppid() == parent_pid:
            burn_io(file.fileno(), block)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
