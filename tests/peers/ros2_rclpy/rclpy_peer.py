# SPDX-License-Identifier: Apache-2.0
"""A node on a real rclpy, in ROS's own Python, without any part of motord. It prints JSON lines.

rclpy_peer.py DOMAIN drive NAMESPACE V W   prints odom and robot_description; sends 20
                                           TwistStamped a second on cmd_vel
rclpy_peer.py DOMAIN watch NAMESPACE       prints motor_status
rclpy_peer.py DOMAIN say TOPIC TEXT NODE   what `ros2 topic pub --rate 50` does: 50
                                           std_msgs/String a second
rclpy_peer.py DOMAIN call SERVICE          what `ros2 service call` does with a std_srvs/Trigger
rclpy_peer.py DOMAIN goal NAMESPACE METRES drive_distance; it sends its goal's id 20 times a second
rclpy_peer.py DOMAIN walk NAMESPACE STEPS TIMES
                                           calls the services of STEPS (JSON, as life_steps.py has
                                           them) TIMES times; prints each answer that differs, and
                                           at the end how often each step was as it has to be
rclpy_peer.py DOMAIN forks                 runs modes in processes of their own, see `forks`
rclpy_peer.py DOMAIN wait SERVICE NODE S   prints whether wait_for_service finds a std_srvs/Trigger
                                           in S seconds, and again when the graph lists it
"""

import contextlib
import json
import os
import signal
import sys
import time
import uuid

import rclpy
from geometry_msgs.msg import TwistStamped
from lifecycle_msgs.srv import ChangeState
from motord_msgs.action import DriveDistance
from motord_msgs.msg import MotorStatus
from nav_msgs.msg import Odometry
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger
from unique_identifier_msgs.msg import UUID

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PERIOD_S = 0.05
SAY_EVERY_S = 0.02


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
    node.create_timer(SAY_EVERY_S, lambda: publisher.publish(String(data=text)))
    rclpy.spin(node)


def call(service):
    node = Node("caller")
    client = node.create_client(Trigger, service)
    client.wait_for_service()
    future = client.call_async(Trigger.Request())
    rclpy.spin_until_future_complete(node, future)
    put(success=future.result().success, message=future.result().message)


def goal(namespace, distance_m):
    node = Node("errand", namespace=namespace)
    number = UUID(uuid=list(uuid.uuid4().bytes))
    publisher = node.create_publisher(UUID, "motord/goal_alive", 1)
    client = ActionClient(node, DriveDistance, "drive_distance")
    client.wait_for_server()
    while publisher.get_subscription_count() < 1:
        rclpy.spin_once(node, timeout_sec=PERIOD_S)
    node.create_timer(PERIOD_S, lambda: publisher.publish(number))
    asked = DriveDistance.Goal(distance_m=float(distance_m))
    future = client.send_goal_async(asked, goal_uuid=number)
    future.add_done_callback(lambda answer: put(accepted=answer.result().accepted))
    rclpy.spin(node)


def walk(namespace, steps, count):
    node = Node("manager", namespace=namespace)
    kinds = {"change_state": ChangeState}
    clients, right = {}, {}
    asked = [(f"{place} {name} {values}", name, values, success)
             for place, (name, values, success) in enumerate(json.loads(steps))]  # fmt: skip
    for _, name, _, _ in asked:
        if name not in clients:
            kind = kinds.get(name, Trigger)
            clients[name] = (kind, node.create_client(kind, f"motord/{name}"))
            clients[name][1].wait_for_service()
    for number in range(int(count)):
        for step, name, values, success in asked:
            kind, client = clients[name]
            request = kind.Request()
            if values:
                request.transition.id = values["transition"]["id"]
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future)
            answer = future.result()
            right[step] = right.get(step, 0) + (answer.success == success)
            if answer.success != success:
                put(round=number, step=step, message=getattr(answer, "message", ""))
    put(right=right)


def wait(service, name, seconds):
    node = Node(name)
    client = node.create_client(Trigger, service)
    put(available=client.wait_for_service(float(seconds)))
    while service not in dict(node.get_service_names_and_types()):
        time.sleep(PERIOD_S)
    put(listed=True, available=client.service_is_ready())
    rclpy.spin(node)


MODES = {mode.__name__: mode for mode in (drive, watch, say, call, goal, walk, wait)}


def run(mode, *words):
    rclpy.init(args=[])
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        MODES[mode](*words)
    rclpy.try_shutdown()


def forks():
    """For each line on standard input end the process of the line before, and run the
    mode in the line (JSON) in a process of its own, which has loaded all it needs."""
    child = 0
    for line in sys.stdin:
        if child:
            os.kill(child, signal.SIGTERM)
            os.waitpid(child, 0)
        words = json.loads(line)
        child = os.fork() if words else 0
        if words and not child:
            run(*words)
            os._exit(0)


if __name__ == "__main__":
    os.environ["ROS_DOMAIN_ID"] = sys.argv[1]
    if sys.argv[2] == "forks":
        forks()
    else:
        run(*sys.argv[2:])
