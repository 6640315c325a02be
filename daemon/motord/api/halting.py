# SPDX-License-Identifier: Apache-2.0
"""Reliable stop, emergency stop and disarm: requested by datagram, confirmed by the daemon's answer
or, if it gives none, by its state page. The answer needs a connection, the page needs none."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

from motord.api.page_file import PAGE
from motord.api.snapshot import STATES, Snapshot
from motord.api.state_page import NoPage, StatePage
from motord.api.stop_request import page_link, send, stop_socket
from motord.client import TIMEOUT_S, Client, ClientError, Refused

ANSWER_WITHIN_S = 3.0
LOOK_EVERY_S = 0.005
_GOING = ("armed", "moving", "stopping")
LAST_RESORT = "cut the power by hand, or end the daemon and use motord stop-all ROBOT.toml"


class NoAnswer(ClientError):
    """The daemon does not answer."""


def halt(local_socket: Path, method: str, timeout_s: float = TIMEOUT_S) -> str:
    """Request "stop", "estop" or "disarm" (`method`) and wait for its effect. Returns the resulting
    state. Raises Refused with the daemon's reason, and ClientError if nothing confirms it in
    time."""
    requested_ns = time.monotonic_ns()
    try:
        send(local_socket, method, timeout_s)
        state = confirmed(local_socket, method, requested_ns, timeout_s)
    except (OSError, ClientError) as error:  # no such socket, or no such page, or a drive too slow
        problem = (isinstance(error, OSError) and error.strerror) or str(error)
        return _answered(local_socket, method, timeout_s, problem)
    if method == "disarm":  # the page does not show which drive has not acknowledged
        with contextlib.suppress(NoAnswer):
            return _answered(local_socket, method, ANSWER_WITHIN_S, "")
    return state


def _answered(local_socket: Path, method: str, timeout_s: float, problem: str) -> str:
    """Return the state from the daemon's answer. `problem`: why nothing else confirms it. Raises
    Refused, NoAnswer."""
    try:
        with Client(local_socket, timeout_s=timeout_s) as client:
            return str(client.call(method)["state"])
    except Refused:
        raise
    except ClientError as error:
        raise NoAnswer(
            f"{method}: not confirmed: {stop_socket(local_socket)}: {problem}; {error}: "
            f"{LAST_RESORT}"
        ) from error


def confirmed(local_socket: Path, method: str, requested_ns: int, within_s: float) -> str:
    """Wait until the state page shows that a request has taken effect and return the state. Raises
    ClientError if it does not in time."""
    end_s = time.monotonic() + within_s
    try:
        with _page(local_socket) as page:
            while True:
                snapshot = page.read()
                if snapshot and (state := outcome(snapshot, method, requested_ns)) is not None:
                    return state
                if time.monotonic() > end_s:
                    raise ClientError(f"the state page does not show it within {within_s:g} s")
                time.sleep(LOOK_EVERY_S)
    except (NoPage, OSError) as error:
        raise ClientError(str(error)) from error


def outcome(snapshot: Snapshot, method: str, requested_ns: int) -> str | None:
    """Return the state to which the request has led; None: it has not taken effect yet."""
    if snapshot.stamp_ns <= requested_ns:
        return None
    state = STATES[snapshot.machine_state] if snapshot.machine_state < len(STATES) else "unknown"
    if snapshot.faults:  # asyncio, which sets the state, may be blocked
        state = "estop" if "estop" in snapshot.faults else "fault"
    off = not (snapshot.armed or snapshot.enabled)
    if method == "disarm" and off and state in _GOING:
        state = "idle"  # the loop has disarmed, asyncio has not followed
    rests = snapshot.at_rest and state not in ("moving", "stopping")
    done = {"estop": state == "estop", "stop": rests, "disarm": off}[method]
    return state if done else None


def _page(local_socket: Path) -> StatePage:
    """Open the state page of the daemon with this socket. Raises NoPage and OSError."""
    link, robot = page_link(local_socket), local_socket.name.removesuffix(".sock")
    with contextlib.suppress(OSError):
        robot = Path(os.readlink(link)).name.removesuffix(PAGE)
    return StatePage.open(robot, owner=stop_socket(local_socket).lstat().st_uid)
