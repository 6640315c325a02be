# SPDX-License-Identifier: Apache-2.0
"""Reliable stop, emergency stop and disarm: requested by datagram, confirmed by the daemon's answer
or, if it gives none, by its state page. The answer needs a connection, the page needs none."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motord.api.page_file import writer_lives
from motord.api.snapshot import (
    KEEP_AWAY,
    STATES,
    Rest,
    Snapshot,
    rest_report,
    rest_text,
    stamp_is_fresh,
)
from motord.api.state_page import NoPage
from motord.api.stop_request import (
    LOOK_EVERY_S,
    RECOVERS_WITHIN_S,
    DaemonHangs,
    Hang,
    NoAnswer,
    Standstill,
    open_sender,
    page_of,
    stop_socket,
    try_send,
)
from motord.client import TIMEOUT_S, Client, ClientError, Refused

ANSWER_WITHIN_S = 3.0
RESTS_WITHIN_S = 5.0
"""Time after a stop in which the wheels are watched until they do not turn any more."""
PAGE_STALE_S = 0.5
NAMES_WITHIN_S = 1.0
_GOING = ("armed", "moving", "stopping")
LAST_RESORT = "cut the power by hand, or motord stop-all ROBOT.toml"


def request_all(local_sockets: Sequence[Path], method: str) -> None:
    """Send the request to several daemons at once, before any of them is waited for."""
    with open_sender() as sender:
        for local_socket in local_sockets:
            with contextlib.suppress(OSError):  # `halt` reports it
                try_send(sender, local_socket, method)


def halt(
    local_socket: Path,
    method: str,
    timeout_s: float = TIMEOUT_S,
    *,
    report: Callable[[Hang], None] = lambda _: None,
    recovers_within_s: float = RECOVERS_WITHIN_S,
) -> str:
    """Request "stop", "estop" or "disarm" (`method`) and wait for its effect. Returns the resulting
    state. `report` is called at once if the daemon hangs; it then has `recovers_within_s` to answer
    all the same. Raises Refused with the daemon's reason, DaemonHangs, and ClientError if nothing
    confirms it in time."""
    try:
        state = _requested(local_socket, method, timeout_s)
    except DaemonHangs as error:
        report(error.hang)
        if recovers_within_s > 0.0:  # it may have been held up, or only its loop hangs
            with contextlib.suppress(NoAnswer):
                return _answered(local_socket, method, recovers_within_s, str(error.hang))
        raise
    except (NoPage, OSError, ClientError) as error:  # no such socket, or a drive too slow
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


def _requested(local_socket: Path, method: str, within_s: float) -> str:
    """Send the request until the loop's queue takes it, and wait until the state page shows its
    effect. Return the state. Raises DaemonHangs, ClientError, OSError and NoPage."""
    end_s = time.monotonic() + within_s
    with contextlib.ExitStack() as stack:
        sender = stack.enter_context(open_sender())
        requested_ns = time.monotonic_ns()
        sent = try_send(sender, local_socket, method)
        page = stack.enter_context(page_of(local_socket))
        standstill = Standstill(page, time.monotonic())
        while True:
            snapshot = page.read() if sent else None
            if snapshot and (state := outcome(snapshot, method, requested_ns)) is not None:
                return state
            standstill.look(time.monotonic())
            if hang := standstill.hang():
                raise DaemonHangs(method, hang)
            if standstill.is_still and not writer_lives(page.path):
                raise ClientError("the daemon has ended")
            if time.monotonic() > end_s:
                doing = "show it" if sent else "take it: the receive queue stays full"
                raise ClientError(f"the daemon does not {doing} within {within_s:g} s")
            time.sleep(LOOK_EVERY_S)
            if not sent:
                requested_ns = time.monotonic_ns()
                sent = try_send(sender, local_socket, method)


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
    # unknown: no rest to wait for; the caller asks `found_rest`
    rests = snapshot.rest != Rest.TURNING and state not in ("moving", "stopping")
    done = {"estop": state == "estop", "stop": rests, "disarm": off}[method]
    return state if done else None


@dataclass(frozen=True, slots=True)
class RestFound:
    """What is known of the robot's rest after a stop."""

    rest: Rest
    unknown_s: Mapping[str, float]
    """Joints of which it is unknown whether they turn, and for how long it has been."""
    unmeasured: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """What a person has to know; empty: the robot was seen at rest."""
        if self.rest is Rest.TURNING:
            return f"the wheels turn: {KEEP_AWAY}"
        return rest_text(self.rest, self.unknown_s, self.unmeasured)


def found_rest(local_socket: Path, within_s: float = RESTS_WITHIN_S) -> RestFound:
    """Wait until nothing is known to turn, `within_s` at most, and return what is known then: by
    the state page or, where none can be read, by the daemon's answer. Unknown: there is neither, or
    the page stands still."""
    end_s = time.monotonic() + within_s
    try:
        with page_of(local_socket) as page:
            while True:
                snapshot, now_ns = page.read(), time.monotonic_ns()
                if snapshot is None or not stamp_is_fresh(now_ns, snapshot.stamp_ns, PAGE_STALE_S):
                    return RestFound(Rest.UNKNOWN, {})
                if snapshot.rest != Rest.TURNING or now_ns / 1e9 > end_s:
                    names = _joint_names(local_socket, len(snapshot.joints))
                    return _found(rest_report(snapshot, names))
                time.sleep(LOOK_EVERY_S)
    except (NoPage, OSError):
        return _answered_rest(local_socket, end_s)


def _answered_rest(local_socket: Path, end_s: float) -> RestFound:
    try:
        with Client(local_socket, timeout_s=NAMES_WITHIN_S) as client:
            while True:
                found = _found(client.status())
                if found.rest != Rest.TURNING or time.monotonic() > end_s:
                    return found
                time.sleep(LOOK_EVERY_S)
    except ClientError:
        return RestFound(Rest.UNKNOWN, {})


def _found(report: Mapping[str, Any]) -> RestFound:
    """Return what the values of `rest_report` say; of a daemon that has none, it is unknown."""
    return RestFound(
        Rest(report.get("rest", Rest.UNKNOWN)),
        report.get("rest_unknown_s", {}),
        tuple(report.get("rest_unmeasured", ())),
    )


def _joint_names(local_socket: Path, count: int) -> Sequence[str]:
    """Return the names of the joints, by their numbers if the daemon does not answer."""
    with contextlib.suppress(ClientError), Client(local_socket, timeout_s=NAMES_WITHIN_S) as client:
        return list(client.call("robot")["joints"])
    return [f"joint {number}" for number in range(1, count + 1)]
