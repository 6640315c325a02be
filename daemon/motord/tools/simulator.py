# SPDX-License-Identifier: Apache-2.0
"""The simulator as its own process: start it, connect to it, end it."""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

from motord.base.python_command import module_command
from motord_hal.sim.control import ControlError, SimControl

START_TIMEOUT_S = 20.0
STOP_TIMEOUT_S = 5.0


class Simulator:
    """A running simulator process. Used as a context manager, it is stopped at the end; it also
    stops when this process ends. `control` is connected to it."""

    def __init__(self, process: subprocess.Popen[bytes], hello: dict[str, Any]) -> None:
        self.process = process
        self.robot: str = hello["robot"]
        self.ports: dict[str, str] = hello["ports"]
        self.settings: list[str] = hello["settings"]
        """Settings KEY=VALUE with which a robot file uses the simulated lines."""
        self.seed: int = hello["seed"]
        self.control_path: str = hello["control"]
        self.control = SimControl(self.control_path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        self.control.close()
        _stop(self.process)


def start_simulator(
    robot: Path | str,
    *,
    faults: Iterable[str] = (),
    seed: int | None = None,
    link_dir: Path | str | None = None,
    control: Path | str | None = None,
    options: Iterable[str] = (),
    timeout_s: float = START_TIMEOUT_S,
) -> Simulator:
    """Start `motord simulate` and wait until its ports are there. `options` are more arguments of
    its command line, for example ("--tcp", "0"). Raise ControlError if it does not start."""
    command = module_command("motord", "simulate", os.fspath(robot), "--json")
    command += ["--stop-on-eof", *options]
    for fault in faults:
        command += ["--fault", fault]
    named = {"--seed": seed, "--link-dir": link_dir, "--control": control}
    for name, value in named.items():
        command += [] if value is None else [name, str(value)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
    line = _first_line(process, timeout_s)
    if not line.endswith(b"\n"):
        _stop(process)
        raise ControlError(f"the simulator did not start: {' '.join(command)}: see stderr")
    hello = json.loads(line)
    if "error" in hello:
        _stop(process)
        raise ControlError(f"the simulator did not start: {hello['error']}")
    return Simulator(process, hello)


def _first_line(process: subprocess.Popen[bytes], timeout_s: float) -> bytes:
    """Return the bytes that came until the newline, the end or the deadline."""
    assert process.stdout is not None
    deadline_s = time.monotonic() + timeout_s
    line = b""
    while not line.endswith(b"\n"):
        left_s = deadline_s - time.monotonic()
        ready = select.select([process.stdout], [], [], max(0.0, left_s))[0]
        data = process.stdout.read(1) if ready else b""
        if not data:
            break
        line += data
    return line


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()
