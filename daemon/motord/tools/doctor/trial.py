# SPDX-License-Identifier: Apache-2.0
"""Starts a daemon for a few seconds, to check a robot's drives while no daemon runs. It is
disarmed, its socket is in a folder that only this user can enter, and it starts no buses."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from motord.base.python_command import module_command
from motord.client import Client, ClientError

START_WITHIN_S = 30.0
SETTLE_WITHIN_S = 8.0
END_WITHIN_S = 20.0
LOOK_EVERY_S = 0.1


@contextlib.contextmanager
def daemon(robot_file: Path, overrides: Sequence[str]) -> Iterator[Client]:
    """Run a daemon in this block. Yield a client, once its lines are ready or SETTLE_WITHIN_S has
    passed. Raise ClientError if the daemon does not start."""
    with tempfile.TemporaryDirectory(prefix="motord-doctor-") as folder:
        path, log = Path(folder) / "trial.sock", Path(folder) / "log"
        words = module_command("motord", "run", str(robot_file), "--no-bus")
        words += ["--socket", str(path)]
        for override in overrides:
            words += ["--set", override]
        with log.open("wb") as sink:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=sink
            )
        try:
            with _connected(process, path, log) as client:
                end_s = time.monotonic() + SETTLE_WITHIN_S
                while time.monotonic() < end_s and client.status().state in ("off", "configuring"):
                    time.sleep(LOOK_EVERY_S)
                yield client
        finally:
            _end(process)


def _connected(process: subprocess.Popen[bytes], path: Path, log: Path) -> Client:
    end_s = time.monotonic() + START_WITHIN_S
    while time.monotonic() < end_s:
        if process.poll() is not None:
            last = log.read_text(errors="replace").strip().splitlines()[-1:]
            raise ClientError(f"a daemon could not be started: {' '.join(last)}")
        with contextlib.suppress(ClientError):
            return Client(path)
        time.sleep(LOOK_EVERY_S)
    raise ClientError(f"a daemon did not start within {START_WITHIN_S:g} s")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(END_WITHIN_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
