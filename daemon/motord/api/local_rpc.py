# SPDX-License-Identifier: Apache-2.0
"""The bytes on the local socket: JSON-RPC 2.0, one object a line. No I/O: both clients,
`motord.client` and `motord.aio`, make and parse the lines with this module."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

REFUSED = -32000
NOT_ALLOWED = -32001
INVALID_PARAMS = -32602
NEEDS_FORCE = -32002
"""Refused, but taken with `force`: the answer gives the reason."""
_NOT_SENT = (float("inf"), float("-inf"))


class ClientError(Exception):
    """The daemon cannot be reached, did not answer or did not understand, as the message states."""


class Refused(ClientError):
    """The daemon understood and refused the request; the message is its reason and the remedy."""

    def __init__(self, reason: str, code: int) -> None:
        super().__init__(reason)
        self.code = code


class WrongParams(ClientError):
    """The request fails in every state of the robot: a value out of range, or an unknown name."""


def request_line(number: int, method: str, params: Mapping[str, Any]) -> bytes:
    """Return the line of a call. Raises ClientError for a number that JSON cannot represent."""
    request = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
    try:
        return json.dumps(request, allow_nan=False).encode() + b"\n"
    except ValueError as error:
        wrong = [name for name, value in params.items() if value in _NOT_SENT or value != value]
        text = f"{method}: {', '.join(wrong) or 'a value'} is NaN or infinite"
        raise ClientError(f"{text}: give finite numbers") from error


def answer_to(number: int, line: bytes, where: object) -> dict[str, Any] | None:
    """Return the answer to that call; None: it is a late answer to another. Raises ClientError."""
    try:
        answer = json.loads(line)
    except ValueError as error:
        raise ClientError(f"{where} does not answer in JSON: {line[:80]!r}") from error
    ours = isinstance(answer, dict) and answer.get("id") in (number, None)
    return answer if ours else None


def result_of(answer: Mapping[str, Any]) -> Any:
    """Return the result in an answer. Raises Refused, and ClientError for every other error."""
    problem = answer.get("error")
    if problem is None:
        return answer.get("result")
    message, code = str(problem.get("message")), int(problem.get("code", 0))
    if code in (REFUSED, NOT_ALLOWED, NEEDS_FORCE):
        raise Refused(message, code)
    raise WrongParams(message) if code == INVALID_PARAMS else ClientError(message)


def given(**params: Any) -> dict[str, Any]:
    """Return the parameters without those that are None, for which the daemon has defaults."""
    return {name: value for name, value in params.items() if value is not None}


def drive_params(
    linear_m_s: float, angular_rad_s: float, lateral_m_s: float, **lease: Any
) -> dict[str, Any]:
    """Return the parameters of the method `drive`, without a `lateral_m_s` of 0, so that a daemon
    that does not know it can be driven, too."""
    lateral = {"lateral_m_s": lateral_m_s} if lateral_m_s != 0.0 else {}
    return {"linear_m_s": linear_m_s, "angular_rad_s": angular_rad_s, **lateral, **given(**lease)}


def joints_params(
    position_rad: Mapping[str, float] | None,
    velocity_rad_s: Mapping[str, float] | None,
    *,
    clamp: bool,
    **lease: Any,
) -> dict[str, Any]:
    """Return the parameters of the method `joints`."""
    wanted = given(position_rad=position_rad, velocity_rad_s=velocity_rad_s)
    params = {name: dict(values) for name, values in wanted.items()} | given(**lease)
    return params | ({"clamp": True} if clamp else {})
