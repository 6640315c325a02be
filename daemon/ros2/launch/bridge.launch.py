# SPDX-License-Identifier: Apache-2.0
"""ros2 launch motord_ros2 bridge.launch.py namespace:=/r2 robot:=r2 cmd_vel:=/cmd_vel_safe"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "motord_ros2"
AGAIN_AFTER_S = 2.0


def generate_launch_description() -> LaunchDescription:
    """The node, which is started again when it ends: a robot file that has changed ends it."""
    file = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "bridge.yaml"])
    arguments = (
        ("namespace", "", "namespace of the node"),
        ("name", "motord", "name of the node; motord-bus has the same one on DDS"),
        ("robot", "", "the robot's name, where several run here; params_file outranks it"),
        ("params_file", file, "parameters of the node"),
        ("cmd_vel", "cmd_vel", "topic of commands"),
        ("joint_commands", "joint_commands", "topic of commands by wheel"),
    )
    node = Node(
        package=PACKAGE,
        executable="bridge",
        name=LaunchConfiguration("name"),
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {"robot": ParameterValue(LaunchConfiguration("robot"), value_type=str)},
            LaunchConfiguration("params_file"),
        ],
        remappings=[(topic, LaunchConfiguration(topic)) for topic in ("cmd_vel", "joint_commands")],
        output="screen",
        respawn=True,
        respawn_delay=AGAIN_AFTER_S,
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, default, text in arguments
    ]
    return LaunchDescription([*declared, node])
