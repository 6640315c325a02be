# SPDX-License-Identifier: Apache-2.0
"""Disarm the robot if the program that started this one ends without having disarmed it: the lease
of that program expires and the robot comes to rest, but the drives would stay powered.

Run it as `python -m motord.commission.dead_man SOCKET`; it takes the end of stdin for the end of
that program."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from motord.api.halting import halt
from motord.base.python_command import module_command
from motord.client import ClientError

DISARMED = b"disarmed"


@contextlib.contextmanager
def dead_man(socket: Path) -> Iterator[None]:
    """Disarm the robot if this process ends within this context, also by kill -9."""
    command = module_command("motord.commission.dead_man", os.fspath(socket))
    # a session of its own: Ctrl-C and a lost terminal must not end this process with its parent
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True
    )
    assert process.stdin is not None
    try:
        yield
        with contextlib.suppress(OSError):
            process.stdin.write(DISARMED)
    finally:
        with contextlib.suppress(OSError):
            process.stdin.close()
        process.wait()


def _main(socket: str) -> None:
    if DISARMED not in sys.stdin.buffer.read():
        with contextlib.suppress(ClientError):  # a daemon that has ended has stopped its drives
            halt(Path(socket), "disarm")


if __name__ == "__main__":
    _main(sys.argv[1])
