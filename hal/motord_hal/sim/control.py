# SPDX-License-Identifier: Apache-2.0
"""Client of the simulator's control socket: reads the truth, injects faults."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from motord_hal.sim.server import LINE_BYTES_MAX

REPLY_TIMEOUT_S = 5.0


class ControlError(RuntimeError):
    """The simulator refused, has ended, or did not answer in time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointTruth:
    """The true state of a wheel, forward positive."""

    position_rad: float
    velocity_rad_s: float
    current_a: float
    enabled: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotTruth:
    """The robot's true motion since the start or the last reset_truth."""

    time_s: float
    """Time on the simulator's clock."""
    x_m: float
    y_m: float
    heading_rad: float
    """Heading from −π to π."""
    distance_m: float
    turned_rad: float
    moved_max_m_s: float
    """Greatest speed of a wheel at its rim."""
    at_rest: bool
    """Whether all wheels are at rest now."""
    rest_since_s: float
    """Time for which all wheels have been at rest."""
    joints: dict[str, JointTruth]


class SimControl:
    """A client of the simulator's control socket. Every call ends within `timeout_s` or raises
    ControlError."""

    def __init__(self, path: Path | str, timeout_s: float = REPLY_TIMEOUT_S) -> None:
        self._buffer = b""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout_s)
        try:
            self._socket.connect(os.fspath(path))
        except OSError as error:
            self._socket.close()
            raise ControlError(f"no simulator at {path}: {error.strerror or error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()

    def call(self, method: str, **params: Any) -> Any:
        """Send one request and return its result. Raises ControlError."""
        try:
            line = json.dumps({"method": method, "params": params})
            self._socket.sendall(line.encode() + b"\n")
            reply = json.loads(self._read_line())
        except OSError as error:
            raise ControlError(f"{method}: the simulator does not answer: {error}") from error
        if "error" in reply:
            raise ControlError(f"{method}: {reply['error']}")
        return reply["result"]

    def _read_line(self) -> bytes:
        while b"\n" not in self._buffer:
            data = self._socket.recv(LINE_BYTES_MAX)
            if not data:
                raise ConnectionResetError("it closed the connection")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line

    def truth(self) -> RobotTruth:
        """Return the robot's true motion, and its wheels' state now."""
        result = self.call("truth")
        joints = {name: JointTruth(**joint) for name, joint in result.pop("joints").items()}
        return RobotTruth(**result, joints=joints)

    def stats(self) -> dict[str, Any]:
        """Return counters of lines, units and faults."""
        result: dict[str, Any] = self.call("stats")
        return result

    def journal(self, line: str, unit: int, since: int = 0) -> list[dict[str, Any]]:
        """Return what a unit of a tagged robot has really answered, from entry `since` on, at most
        1000 entries: number, monotonic_ns, function, address, words."""
        result: list[dict[str, Any]] = self.call("journal", line=line, unit=unit, since=since)
        return result

    def reset_truth(self) -> None:
        """Set the pose to the origin, and distance, turn and fastest wheel to zero."""
        self.call("reset_truth")

    def inject(self, spec: str) -> None:
        """Add a fault to the script. Its times count from now."""
        self.call("inject", spec=spec)

    def clear_faults_script(self) -> None:
        """End all faults. A fault that a drive has latched stays latched."""
        self.call("clear_faults_script")

    def pull(self, line: str | None = None) -> None:
        """Unplug the adapter of a line; None: of all lines."""
        self.call("pull", line=line)

    def plug(self, line: str | None = None) -> None:
        """Plug the adapter in again. The device file then has another number."""
        self.call("plug", line=line)
