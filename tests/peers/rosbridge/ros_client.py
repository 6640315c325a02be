# SPDX-License-Identifier: Apache-2.0
"""A program of a user with roslibpy: python ros_client.py URL [VX VY]. It drives, stops and resets
the robot, and prints what it received. With VX and VY it commands these until it is killed."""

import json
import sys
import threading
import time

import roslibpy

WITHIN_S = 30


def first(ros, topic, kind):
    """Return the first message of a topic."""
    came, found = threading.Event(), []

    def take(message):
        found.append(message)
        came.set()

    reader = roslibpy.Topic(ros, topic, kind)
    reader.subscribe(take)
    assert came.wait(WITHIN_S), topic
    reader.unsubscribe()
    return found[0]


def plane(cmd_vel, linear_m_s, lateral_m_s):
    linear = {"x": float(linear_m_s), "y": float(lateral_m_s), "z": 0.0}
    while True:
        cmd_vel.publish(roslibpy.Message({"linear": linear, "angular": {"z": 0.0}}))
        time.sleep(0.05)


def main():
    ros = roslibpy.Ros(sys.argv[1])
    ros.run(timeout=WITHIN_S)
    cmd_vel = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
    if sys.argv[2:]:
        plane(cmd_vel, *sys.argv[2:])

    def trigger(name):
        service = roslibpy.Service(ros, name, "std_srvs/Trigger")
        return dict(service.call(roslibpy.ServiceRequest(), timeout=WITHIN_S))

    found = {
        "topics": ros.get_topics(),
        "odom": first(ros, "/odom", "nav_msgs/Odometry"),
        "arm": trigger("/arm"),
    }
    moving, ending = threading.Event(), threading.Event()

    def drive():
        while not ending.wait(0.05):
            cmd_vel.publish(roslibpy.Message({"linear": {"x": 0.2}, "angular": {"z": 0.0}}))

    def look(message):
        if message["commander"] == "web" and message["state"] == "moving":
            found["motor_status"] = message
            moving.set()

    watching = roslibpy.Topic(ros, "/motor_status", "motord_msgs/MotorStatus")
    watching.subscribe(look)
    driver = threading.Thread(target=drive)
    driver.start()
    try:
        assert moving.wait(WITHIN_S), "it does not move"
    finally:
        ending.set()
        driver.join()
    end_s = time.monotonic() + WITHIN_S
    found["estop"] = trigger("/estop")
    cmd_vel.publish(roslibpy.Message({"linear": {"x": 0.0}, "angular": {"z": 0.0}}))
    found["reset"] = trigger("/reset")
    while not found["reset"]["success"] and time.monotonic() < end_s:  # until zero is received
        found["reset"] = trigger("/reset")
    print(json.dumps(found))
    ros.terminate()


main()
