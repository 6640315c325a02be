# SPDX-License-Identifier: Apache-2.0
"""What motord-bus serves on DDS, served on another node: the same code calls the same daemon under
the lease of an [input.*] of kind "ros2-rclpy". The standard library alone.

The robot file is not here: the daemon reports what the commands need of it. When the daemon
restarts, the lease is taken again, and nothing moves before the robot is armed. A daemon with
another robot file than the one before is not served: its wheels may have other places.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

from motord.aio import Client
from motord.api.state_page import NoPage, StatePage
from motord.bus.adapters import Adapter
from motord.bus.commands.gate import NotTaken
from motord.bus.commands.link import Source, call
from motord.bus.parameters import Tunable
from motord.bus.ros2.commands import Ros2Commands
from motord.bus.ros2.nodes import Node
from motord.bus.runtime import Runtime
from motord.client import ClientError, find_socket

if TYPE_CHECKING:
    from motord.config import Robot, Ros2Input

KIND = "ros2-rclpy"
ASK_AGAIN_S = 0.5

_log = logging.getLogger(__name__)


class Wrong(Exception):
    """It cannot go on like this; the text says what to do."""


@dataclass(frozen=True, kw_only=True)
class BridgeOptions:
    """What the node's parameters request."""

    robot: str | None = None
    """None: the only one that runs here."""
    socket: Path | None = None
    input: str = "ros"
    stamped: bool = True
    """Every command has to say when it was given; cmd_vel is a TwistStamped."""
    limits: Mapping[str, float] = field(default_factory=dict)
    """Robot parameters (limits.*) that are set whenever the lease is taken."""


async def serve(options: BridgeOptions, node: Node) -> None:
    """Until cancelled. Raises Wrong."""
    path, description = await _described(options)
    _log.info("%s: robot %s", path, description["robot"])
    robot = _robot(description)
    section = SimpleNamespace(
        stamped=options.stamped, lease_s=_input(description, options.input)["lease_s"]
    )
    runtime = BridgeRuntime(robot, path, description, options.limits)
    # It reads no more than that of the section.
    commands = Ros2Commands(options.input, cast("Ros2Input", section), runtime, node)
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(runtime.run())
        tasks.create_task(commands.run())


async def _described(options: BridgeOptions) -> tuple[Path, dict[str, Any]]:
    """The daemon's socket, and what it says of its robot, as soon as there is a daemon."""
    last_error = ""
    while True:
        try:
            path = options.socket or find_socket(options.robot)
            return path, await call(path, "robot")
        except ClientError as error:
            if str(error) != last_error:
                last_error = str(error)
                _log.warning("waiting for a daemon: %s", error)
        await asyncio.sleep(ASK_AGAIN_S)


def _input(description: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The input of that name. Raises Wrong."""
    for found in description["inputs"]:
        if found["name"] == name and found["kind"] == KIND:
            return cast("Mapping[str, Any]", found)
    raise Wrong(
        f'the robot file of {description["robot"]} has no [input.{name}] with kind = "{KIND}"'
    )


def _robot(description: Mapping[str, Any]) -> Robot:
    """As much of a robot file as the commands read."""
    base = SimpleNamespace(
        kind="" if description.get("drives", True) else "joints",
        track_m=description["track_m"],
        wheel_radius_m=description["wheel_radius_m"],
        strafes=description["strafes"],
    )
    positions = description.get("takes_position", ())
    joints = {
        name: SimpleNamespace(position_max_rad=0.0 if name in positions else None)
        for name in description["joints"]
    }
    made = SimpleNamespace(
        robot=SimpleNamespace(name=description["robot"]),
        joint=joints,
        base=base,
        limits=SimpleNamespace(**description["limits"]),
        safety=SimpleNamespace(feedback_timeout_s=description["feedback_timeout_s"]),
    )
    return cast("Robot", made)


def _shape(description: Mapping[str, Any]) -> dict[str, Any]:
    """What a robot that is served on has to keep. The limits of its file may change: the daemon
    keeps to them, and a command far beyond the old ones is called so."""
    return {key: value for key, value in description.items() if key != "limits"}


class BridgeRuntime(Runtime):
    """Of a robot whose file is not here."""

    def __init__(
        self, robot: Robot, path: Path, description: Mapping[str, Any], limits: Mapping[str, float]
    ) -> None:
        super().__init__(robot, path)
        self._description, self._limits = description, limits

    def source(self, name: str) -> Source:
        """As Runtime.source."""
        self.sources[name] = BridgeSource(
            self.path, name, self.robot, self._description, self._limits
        )
        return self.sources[name]

    def _adapters(self) -> dict[str, Adapter]:
        """No sections are read here."""
        return {}

    def page(self) -> StatePage:
        """That of the daemon's user, who may be another than ours."""
        try:
            owner = self.path.stat().st_uid
        except OSError as error:
            raise NoPage(f"{self.path}: {error.strerror}") from error
        return StatePage.open(self.robot.robot.name, owner=owner)


class BridgeSource(Source):
    """Takes a lease only from a daemon with the same robot file."""

    def __init__(
        self,
        path: Path,
        owner: str,
        robot: Robot,
        description: Mapping[str, Any],
        limits: Mapping[str, float],
    ) -> None:
        super().__init__(path, owner)
        self._robot, self._description, self._limits = robot, description, limits

    async def _grant(self, daemon: Client) -> dict[str, Any]:
        """As Source._grant. Raises Wrong."""
        if _shape(await daemon.call("robot")) != _shape(self._description):
            raise Wrong("the robot file has changed since this bridge started: restart the bridge")
        if self._limits:
            try:
                await Tunable(self._robot, daemon.call).change(self._limits)
            except NotTaken as error:
                _log.error("parameters of this node: %s", error)
        return await super()._grant(daemon)
