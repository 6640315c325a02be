# SPDX-License-Identifier: Apache-2.0
"""Messages and calls for tests of the rclpy bridge with a running robot."""

import time

from tests.peers.ros2_rclpy.rclpy_stage import Trigger
from tests.sim.daemon_stage import wait_until


def types():
    import geometry_msgs.msg
    import lifecycle_msgs.msg
    import lifecycle_msgs.srv
    import rcl_interfaces.msg
    import rcl_interfaces.srv
    import sensor_msgs.msg
    import std_msgs.msg
    import std_srvs.srv

    found = {}
    for module in (
        geometry_msgs.msg, lifecycle_msgs.msg, lifecycle_msgs.srv, rcl_interfaces.msg,
        rcl_interfaces.srv, sensor_msgs.msg, std_msgs.msg, std_srvs.srv,
    ):  # fmt: skip
        found |= vars(module)
    return type("Types", (), found)


T = types()
__all__ = ["T", "Trigger", "drive_until", "stamped", "trigger", "twist", "types"]


def trigger(stage, method):
    answer = stage.operator.call(f"motord/{method}", Trigger)
    return answer.success, answer.message


def stamped(message, age_s=0.0):
    sec, nanosec = divmod(time.time_ns() - round(age_s * 1e9), 10**9)
    message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
    return message


def twist(linear_m_s, angular_rad_s=0.0, age_s=0.0, lateral_m_s=0.0):
    message = stamped(T.TwistStamped(), age_s)
    message.twist.linear.x, message.twist.angular.z = linear_m_s, angular_rad_s
    message.twist.linear.y = lateral_m_s
    return message


def drive_until(stage, publisher, message, condition, what):
    def attempt():
        publisher.publish(message())
        time.sleep(0.01)
        return condition()

    return wait_until(attempt, f"{what}\n{stage.bridge.logged()}")
