# SPDX-License-Identifier: Apache-2.0
"""A node on a real rclpy, in ROS's own Python, without any part of motord. It prints JSON lines.

rclpy_peer.py DOMAIN drive NAMESPACE V W   prints odom and robot_description; sends 20
                                           TwistStamped a second on cmd_vel
rclpy_peer.py DOMAIN watch NAMESPACE       prints motor_status
rclpy_peer.py DOMAIN say TOPIC TEXT NODE   20 std_msgs/String a second
rclpy_peer.py DOMAIN wait SERVICE NODE S   prints whether wait_for_service finds a std_srvs/Trigger
                                           in S seconds, and again when the graph lists it
"""

import json
import os
import sys
import time

import rclpy
from geometry_msgs.msg import TwistStamped
from motord_msgs.msg import MotorStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PERIOD_S = 0.05


def put(**values):
    print(json.dumps(values), flush=True)


def drive(namespace, linear_m_s, angular_rad_s):
    node = Node("driver", namespace=namespace)

    def odometry(message):
        put(
            x_m=message.pose.pose.position.x,
            linear_m_s=message.twist.twist.linear.x,
            frames=[message.header.frame_id, message.child_frame_id],
        )

    node.create_subscription(Odometry, "odom", odometry, 10)
    node.create_subscription(
        String, "robot_description", lambda message: put(description=message.data[:12]), LATCHED
    )
    publisher = node.create_publisher(TwistStamped, "cmd_vel", 10)

    def command():
        message = TwistStamped()
        message.header.stamp = node.get_clock().now().to_msg()
        message.twist.linear.x = float(linear_m_s)
        message.twist.angular.z = float(angular_rad_s)
        publisher.publish(message)

    node.create_timer(PERIOD_S, command)
    rclpy.spin(node)


def watch(namespace):
    node = Node("watcher", namespace=namespace)

    def status(message):
        speeds = dict(zip(message.name, message.setpoint_rad_s, strict=True))
        put(state=message.state, setpoint_rad_s=speeds)

    node.create_subscription(MotorStatus, "motor_status", status, 10)
    rclpy.spin(node)


def say(topic, text, name):
    node = Node(name)
    publisher = node.create_publisher(String, topic, 10)
    node.create_timer(PERIOD_S, lambda: publisher.publish(String(data=text)))
    rclpy.spin(node)


def wait(service, name, seconds):
    node = Node(name)
    client = node.create_client(Trigger, service)
    put(available=client.wait_for_service(float(seconds)))
    while service not in dict(node.get_service_names_and_types()):
        time.sleep(PERIOD_S)
    put(listed=True, available=client.service_is_ready())
    rclpy.spin(node)


if __name__ == "__main__":
    os.environ["ROS_DOMAIN_ID"] = sys.argv[1]
    rclpy.init(args=[])
    {"drive": drive, "watch": watch, "say": say, "wait": wait}[sys.argv[2]](*sys.argv[3:])
