# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 package of the bridge node: colcon build, or pip install --no-deps. It carries those
parts of motord that the node needs, for itself alone: in ROS's own Python nothing of motord has to
be installed, and a motord that is installed there is left alone."""

from setuptools import setup

NAME = "motord_ros2"
LIBRARY = (
    "motord", "motord.api", "motord.base", "motord.bus", "motord.bus.commands",
    "motord.bus.messages", "motord.bus.ros2", "motord.bus.ros2.services", "motord.ros2_rclpy",
    "motord_hal", "motord_hal.base",
)  # fmt: skip

setup(
    name=NAME,
    version="0.1.0",
    description="Everything that commands a robot of motord, as a ROS 2 node",
    license="Apache-2.0",
    maintainer="motord",
    maintainer_email="nobody@motord.invalid",
    python_requires=">=3.11",
    packages=[NAME, *(f"{NAME}._lib.{package}" for package in LIBRARY)],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/bridge.launch.py"]),
        (f"share/{NAME}/config", ["config/bridge.yaml"]),
        (f"lib/{NAME}", ["scripts/bridge"]),
    ],
    zip_safe=False,
)
