# SPDX-License-Identifier: Apache-2.0
"""ROS 2 without ROS: types, names, encoding and graph of an ordinary node, on plain DDS."""
