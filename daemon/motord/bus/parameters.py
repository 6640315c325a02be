# SPDX-License-Identifier: Apache-2.0
"""Parameters that every bus shows: the limits of the base, or of each joint of a robot without a
base, which may be changed while the robot runs, and measures of the robot file, which may not. The
daemon decides what may be changed, and gives the reasons."""

from __future__ import annotations

import logging
import math
from collections.abc import Awaitable, Callable, Mapping
from typing import TYPE_CHECKING, Any

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.gate import NotTaken
from motord.client import ClientError

if TYPE_CHECKING:
    from motord.config import Robot

_LIMITS, _JOINT, _GAINS = "limits.", "joint.", ".speed_loop."
_FIXED = ("track_m", "wheel_radius_m")
Call = Callable[..., Awaitable[Any]]

_log = logging.getLogger(__name__)


class Tunable:
    def __init__(self, robot: Robot, call: Call) -> None:
        """`call` calls the daemon. It raises ClientError, and NotTaken for a change that is not
        possible now."""
        self._call = call
        self._voice = RateLimitedLog(_log)
        drives = robot.base.kind != "joints"
        self._tunable = _LIMITS if drives else _JOINT
        self.fixed: dict[str, dict[str, Any]] = {
            f"base.{key}": {
                "value": getattr(robot.base, key),
                "unit": "m",
                "description": "of the robot file",
            }
            for key in _FIXED
            if drives
        }

    async def known(self) -> dict[str, dict[str, Any]]:
        """Return the parameters by name, as params.list describes them. If the daemon does not
        answer, return only those of the robot file."""
        try:
            listed: Mapping[str, dict[str, Any]] = await self._call("params.list")
        except ClientError as error:
            self._voice.say(f"parameters: {error}")
            listed = {}
        limits = {name: about for name, about in listed.items() if self._is_limit(name)}
        return limits | self.fixed

    def _is_limit(self, name: str) -> bool:
        return name.startswith(self._tunable) and _GAINS not in name

    def problem(self, name: str) -> str | None:
        """Return why a parameter cannot be changed; None if only the daemon can decide that."""
        if name in self.fixed:
            return f"{name} comes from the robot file and cannot be changed while the daemon runs"
        if not self._is_limit(name):
            return f"no parameter {name!r}: they begin with {self._tunable}"
        return None

    async def change(self, wanted: Mapping[str, float]) -> None:
        """Change all of the parameters or none; infinity stands for no limit. Raises NotTaken."""
        for name, value in wanted.items():
            if (reason := self.problem(name)) is not None:
                raise NotTaken(reason)
            if math.isnan(value) or value == -math.inf:
                raise NotTaken(f"{name}: {value} is not a number")
        asked = {name: value if math.isfinite(value) else None for name, value in wanted.items()}
        try:
            await self._call("params.set", **asked)
        except ClientError as error:
            raise NotTaken(str(error)) from error


def value_of(about: Mapping[str, Any]) -> float:
    """Return the value of a parameter; null stands for infinity, which JSON does not have."""
    return math.inf if about["value"] is None else float(about["value"])
