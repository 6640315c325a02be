# SPDX-License-Identifier: Apache-2.0
"""ROS 2 without an installed ROS: types, names, encoding and graph of a node, on DDS or Zenoh."""
