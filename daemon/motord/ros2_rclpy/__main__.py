# SPDX-License-Identifier: Apache-2.0
"""`python3 -m motord.ros2_rclpy`: a ROS 2 node by rclpy, in a process of its own, with the services
of the robot and its cmd_vel. It needs a sourced ROS 2, and of motord only this package."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from motord.client import ClientError, find_socket
from motord.ros2_rclpy.bridge import Bridge

_FAILED, _USAGE = 1, 2


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python3 -m motord.ros2_rclpy",
        description="Services and cmd_vel of a running robot, as a node of an installed ROS 2.",
        epilog="Example: python3 -m motord.ros2_rclpy --input ros --ros-args -r __ns:=/r2",
    )
    parser.add_argument("--robot", help="its name; the only one that runs here otherwise")
    parser.add_argument("--socket", type=Path, help="the daemon's local socket")
    parser.add_argument(
        "--input", default="ros", help='section of the robot file with kind = "ros2-rclpy" (ros)'
    )
    parser.add_argument(
        "--unstamped", action="store_true", help="cmd_vel is a Twist, and what arrives is new"
    )
    asked, ros_arguments = parser.parse_known_args(arguments)
    try:
        from motord.ros2_rclpy.node import spin
    except ImportError as error:
        print(f"no ROS 2 in this Python ({sys.executable}): {error}", file=sys.stderr)
        return _USAGE
    try:
        path = asked.socket or find_socket(asked.robot)
    except ClientError as error:
        print(error, file=sys.stderr)
        return _FAILED
    bridge = Bridge(path, asked.input, stamped=not asked.unstamped)
    try:
        spin(bridge, ros_arguments, stamped=not asked.unstamped)
    finally:
        bridge.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
