# SPDX-License-Identifier: Apache-2.0
"""A bridge for machines that have ROS 2: docs/ros2.md. Runs in ROS's own Python."""
