# SPDX-License-Identifier: Apache-2.0
"""A bridge for machines with an installed ROS 2 (docs/ros2.md). It runs in the Python of ROS 2."""
