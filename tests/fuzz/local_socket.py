# SPDX-License-Identifier: Apache-2.0
"""Hostile lines for the daemon's local socket. A good request is answered after them, and none of
them arms or moves the robot."""

from __future__ import annotations

import contextlib
import itertools
import json
import random
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from mutate import mutated
from tests.sim.daemon_stage import Stage, running

from motord.client import Client, ClientError
from motord.local_socket.server import LINE_BYTES_MAX

LINES = 60
"""Largest number of lines of one connection; a line that is too long ends it earlier."""
READ_WITHIN_S = 20.0
METHODS = (
    "status", "disarm", "stop", "estop", "reset", "reset_odometry", "drive", "lease", "release",
    "params.list", "params.get", "params.set", "latency", "nothing", "",
)  # fmt: skip
"""All methods but `arm`, and two that do not exist."""
WORDS = (
    b"NaN", b"Infinity", b"-1e999", b"1e999", b"null", b"true", b"{}", b"[]", b'""', b"\xff", b"\n",
    b"\r", b"\x00", b'"\\ud800"', b"\xed\xa0\x80", b'"2.0"', b'"id"', b'"params"', b'"method"',
    b"9" * 400, b"9" * 5000, b"[" * 5000, b'{"a":' * 3000, b"x" * LINE_BYTES_MAX,
    "\N{GREEK SMALL LETTER OMEGA}".encode("utf-16"),
)  # fmt: skip
VALUES = (
    None, True, 0, -1, 10**300, 10**400, 1e308, float("nan"), float("inf"), "", "socket", "\ud800",
    "x" * 900, [], {}, [[[]]], "limits.linear_m_s",
)  # fmt: skip
KEYS = ("linear_m_s", "angular_rad_s", "owner", "priority", "lease_s", "names", "limits.linear_m_s",
        "limits.linear_m_s3", "values", "")  # fmt: skip


def run(seed: int, runs: int) -> Iterator[tuple[str, bytes]]:
    """Yield each problem with its input."""
    dice = random.Random(seed)
    with (
        tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
        running(Path(folder)) as stage,
    ):
        stage.wait_for("idle")
        for _ in range(runs):
            sent = [_line(dice) for _ in range(dice.randint(1, LINES))]
            _talk(dice, stage.socket, sent)
            try:
                problem = _judge(stage)
            except ClientError as error:
                problem = f"a good request is not answered: {error}"
            if problem:
                yield f"{problem}\n{stage.logged()[-2000:]}", b"".join(sent)
                if stage.daemon.poll() is not None:
                    return


def _judge(stage: Stage) -> str:
    with Client(stage.socket) as good:
        status = good.status()
        state = status["state"]
        if status["armed"] or state in ("armed", "moving"):
            return f"the robot is {state}"
        if state in ("fault", "estop", "stopping"):
            with contextlib.suppress(ClientError):  # stopping: reset at the next check
                good.reset()
    truth = stage.sim.truth()
    if truth.moved_max_m_s > 0.0 or any(joint.enabled for joint in truth.joints.values()):
        return "a wheel has moved, or a drive is enabled"
    if "Traceback" in stage.logged():
        return "the daemon's log has a traceback"
    return ""


def _line(dice: random.Random) -> bytes:
    arms = dice.random() < 0.2
    request = {
        "jsonrpc": dice.choice(("2.0", "2.0", "2.0", 2.0, "1.0", None)),
        "id": dice.choice((1, "a", None, 1.5, [], {}, True, 10**300)),
        "method": "arm" if arms else dice.choice(METHODS),
        "params": {key: dice.choice(VALUES) for key in KEYS if dice.random() < 0.2},
    }
    for key in list(request):
        if dice.random() < 0.05:
            del request[key]
    line = json.dumps(request).encode()
    if dice.random() < 0.5:
        line = mutated(dice, line, WORDS)
    # a change may have split the line
    parts = [b"[]" if _arms_by_right(part) else part for part in line.split(b"\n")]
    return b"\n".join(parts) + b"\n"


def _arms_by_right(line: bytes) -> bool:
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):
        return False
    if not isinstance(request, dict) or request.get("method") != "arm":
        return False
    return request.get("jsonrpc") == "2.0" and request.get("params", {}) == {}


def _talk(dice: random.Random, path: Path, lines: list[bytes]) -> None:
    """Send all lines over one connection, in pieces, and read the answers or leave them unread."""
    data = b"".join(lines)
    cuts = sorted(dice.randint(0, len(data)) for _ in range(dice.choice((0, 1, 5, 50))))
    with socket.socket(socket.AF_UNIX) as peer:
        peer.settimeout(READ_WITHIN_S)
        peer.connect(str(path))
        reads = dice.random() < 0.8
        with contextlib.suppress(ConnectionError, TimeoutError):  # the daemon may close it
            for begin, end in itertools.pairwise((0, *cuts, len(data))):
                peer.sendall(data[begin:end])
            if reads:
                peer.shutdown(socket.SHUT_WR)
                while peer.recv(1 << 16):
                    pass
