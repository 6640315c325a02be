# SPDX-License-Identifier: Apache-2.0
"""The node itself: the only file that knows rclpy."""

from __future__ import annotations

from typing import Any

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from motord.ros2_rclpy.bridge import TRIGGERS, Bridge, NotTaken

NEWEST = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT
)
"""Hears reliable writers and others; an old command is worth nothing."""
SAY_AGAIN_S = 10.0


def spin(bridge: Bridge, arguments: list[str], *, stamped: bool) -> None:
    """Until the process is told to end."""
    rclpy.init(args=arguments)
    node = _node(bridge, stamped)
    executor = MultiThreadedExecutor(num_threads=len(TRIGGERS) + 1)
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def _node(bridge: Bridge, stamped: bool) -> Node:
    """Each service waits for itself alone: an emergency stop does not stand behind an arming."""
    node = Node("motord")
    for method in TRIGGERS:
        node.create_service(
            Trigger,
            f"~/{method}",
            _answer(bridge, method),
            callback_group=MutuallyExclusiveCallbackGroup(),
        )

    def drive(message: Any) -> None:
        twist, stamp = message, None
        if stamped:
            twist = message.twist
            stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        try:
            bridge.drive(twist.linear.x, twist.angular.z, stamp)
        except NotTaken as error:
            node.get_logger().warning(f"cmd_vel: {error}", throttle_duration_sec=SAY_AGAIN_S)

    node.create_subscription(
        TwistStamped if stamped else Twist,
        "cmd_vel",
        drive,
        NEWEST,
        callback_group=MutuallyExclusiveCallbackGroup(),
    )
    return node


def _answer(bridge: Bridge, method: str) -> Any:
    def answer(_: Any, response: Any) -> Any:
        response.success, response.message = bridge.call(method)
        return response

    return answer
