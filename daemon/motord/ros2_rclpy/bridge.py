# SPDX-License-Identifier: Apache-2.0
"""Serves on a node of an installed ROS 2 what motord-bus serves on DDS: the same code calls the
same daemon under the lease of an [input.*] of kind "ros2-rclpy". It uses only the standard library.

The bridge has no robot file: the daemon reports what the commands need of it. When the daemon
restarts, the bridge takes the lease again, and nothing moves before the robot is armed. It does not
serve a daemon with another robot file than before, because its wheels may have other places.
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
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.config import Robot, Ros2Input

KIND = "ros2-rclpy"
ASK_AGAIN_S = 0.5

_log = logging.getLogger(__name__)


class Wrong(Exception):
    """The bridge cannot go on; the text contains what the user should do."""


@dataclass(frozen=True, kw_only=True)
class BridgeOptions:
    """Options of the bridge, from the node's parameters."""

    robot: str | None = None
    """Name of the robot; None: the only one that runs on this machine."""
    socket: Path | None = None
    input: str = "ros"
    stamped: bool = True
    """Whether every command needs a stamp, so that cmd_vel is a TwistStamped."""
    limits: Mapping[str, float] = field(default_factory=dict)
    """Robot parameters (limits.*) that the bridge sets whenever it takes the lease."""


async def serve(options: BridgeOptions, node: Node) -> None:
    """Serve until cancelled. Raise Wrong if the bridge cannot serve the daemon."""
    path, description = await _described(options)
    _log.info("%s: robot %s", path, description["robot"])
    robot = _robot(description)
    source = _input(description, options.input)
    section = SimpleNamespace(
        stamped=options.stamped,
        lease_s=source["lease_s"],
        goal_lease_s=source.get("goal_lease_s"),
    )
    runtime = BridgeRuntime(robot, path, description, options.limits)
    # Ros2Commands reads only these settings of the section.
    commands = Ros2Commands(options.input, cast("Ros2Input", section), runtime, node)
    async with TaskGroup() as tasks:
        tasks.create_task(runtime.run())
        tasks.create_task(commands.run())


async def _described(options: BridgeOptions) -> tuple[Path, dict[str, Any]]:
    """Wait for a daemon; return its socket and its description of the robot."""
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
    """Return the input of that name. Raise Wrong if the robot file has no such input."""
    for found in description["inputs"]:
        if found["name"] == name and found["kind"] == KIND:
            return cast("Mapping[str, Any]", found)
    raise Wrong(
        f'the robot file of {description["robot"]} has no [input.{name}] with kind = "{KIND}"'
    )


def _robot(description: Mapping[str, Any]) -> Robot:
    """Make an object with those parts of a robot file that the commands read."""
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
    """Return the part of a description that must not change while the bridge serves: everything but
    the limits. The daemon applies the new ones; the bridge judges commands by the old ones."""
    return {key: value for key, value in description.items() if key != "limits"}


class BridgeRuntime(Runtime):
    """The runtime for a robot whose file the bridge does not have."""

    def __init__(
        self, robot: Robot, path: Path, description: Mapping[str, Any], limits: Mapping[str, float]
    ) -> None:
        super().__init__(robot, path)
        self._description, self._limits = description, limits

    def source(self, name: str) -> Source:
        """Override `Runtime.source`: the source is a BridgeSource."""
        self.sources[name] = BridgeSource(
            self.path, name, self.robot, self._description, self._limits
        )
        return self.sources[name]

    def _adapters(self) -> dict[str, Adapter]:
        """Return no adapters, because there are no sections of a robot file."""
        return {}

    def page(self) -> StatePage:
        """Open the state page of the daemon's user, which may differ from the user of this
        process. Raise NoPage if the socket is missing."""
        try:
            owner = self.path.stat().st_uid
        except OSError as error:
            raise NoPage(f"{self.path}: {error.strerror}") from error
        return StatePage.open(self.robot.robot.name, owner=owner)


class BridgeSource(Source):
    """A source that takes a lease only from a daemon with the same robot file."""

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
        """Extend `Source._grant`: check the robot file first, and set the robot parameters. Raise
        Wrong if the robot file has changed."""
        if _shape(await daemon.call("robot")) != _shape(self._description):
            raise Wrong("the robot file has changed since this bridge started: restart the bridge")
        if self._limits:
            try:
                await Tunable(self._robot, daemon.call).change(self._limits)
            except NotTaken as error:
                _log.error("parameters of this node: %s", error)
        return await super()._grant(daemon)
