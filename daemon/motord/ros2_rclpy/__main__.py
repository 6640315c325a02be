# SPDX-License-Identifier: Apache-2.0
"""`ros2 run motord_ros2 bridge`, or `python3 -m motord.ros2_rclpy`: a node of an installed ROS 2
that takes all commands for the robot, in its own process."""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motord.bus.guard import first
from motord.ros2_rclpy.bridge import BridgeOptions, Wrong, serve
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.ros2_rclpy.node import RclpyNode

NAME = "motord"
_FAILED, _USAGE = 1, 2
_TEXTS, _LIMITS = ("robot", "socket", "input"), "limits."
_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")
"""Beginnings of the names of parameters that every node has."""

_log = logging.getLogger(__name__)


def main(arguments: list[str] | None = None) -> int:
    """Run the bridge and return the exit status."""
    given, ros_arguments = _parser().parse_known_args(arguments)
    try:
        from motord.ros2_rclpy.node import Ended, RclpyNode, opened, parameters_of
    except ImportError as error:
        print(f"no ROS 2 in this Python ({sys.executable}): {error}", file=sys.stderr)
        return _USAGE
    logging.getLogger().setLevel(logging.INFO)
    with opened(NAME, ros_arguments) as node:
        options_given = {key: value for key, value in vars(given).items() if value is not None}
        try:
            options = options_of(parameters_of(node) | options_given)
        except ValueError as error:
            _log.error("%s", error)
            return _USAGE
        ended_by: BaseException | None = None
        try:
            asyncio.run(run(options, RclpyNode(node)))
        except* (Ended, Wrong) as errors:
            ended_by = first(errors)
            _log.error("%s", ended_by)
    return 0 if ended_by is None else _FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2 run motord_ros2 bridge",
        description="Everything that commands a running robot, as a node of an installed ROS 2.",
        epilog="Each of these is a parameter of the node, too: "
        "--ros-args -r __ns:=/r2 --params-file bridge.yaml",
    )
    parser.add_argument("--robot", help="its name; the only one that runs here otherwise")
    parser.add_argument("--socket", help="the daemon's local socket")
    parser.add_argument(
        "--input", help='section of the robot file with kind = "ros2-rclpy" (default: ros)'
    )
    parser.add_argument(
        "--unstamped",
        dest="stamped",
        action="store_false",
        default=None,
        help="cmd_vel is a Twist, and what arrives is new",
    )
    return parser


def options_of(parameters: Mapping[str, Any]) -> BridgeOptions:
    """Make the options from the node's parameters and command-line options. Raise ValueError for an
    unknown parameter or a bad value."""
    found: dict[str, Any] = {}
    limits: dict[str, float] = {}
    for name, value in parameters.items():
        if name in _TEXTS:
            if not isinstance(value, str):
                raise ValueError(f"parameter {name}: must be a string, not {value!r}")
            if value:  # a launch file cannot omit a parameter: an empty one counts as missing
                found[name] = value
        elif name == "stamped":
            if not isinstance(value, bool):
                raise ValueError(f"parameter stamped: true or false, not {value!r}")
            found[name] = value
        elif name.startswith(_LIMITS):
            if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
                raise ValueError(f"parameter {name}: a number, not {value!r}")
            limits[name] = float(value)
        elif not name.startswith(_OF_ROS):
            known = ", ".join((*_TEXTS, "stamped", "limits.*"))
            raise ValueError(f"no parameter {name}; there are: {known}")
    if "socket" in found:
        found["socket"] = Path(found["socket"])
    return BridgeOptions(**found, limits=limits)


async def run(options: BridgeOptions, node: RclpyNode) -> None:
    """Serve until a signal comes or ROS 2 ends. Raise Wrong or Ended, in an exception group."""
    end = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    async with TaskGroup() as tasks:
        work = tasks.create_task(serve(options, node))
        await end.wait()
        work.cancel()


if __name__ == "__main__":
    sys.exit(main())
