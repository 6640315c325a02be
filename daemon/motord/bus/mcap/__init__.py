# SPDX-License-Identifier: Apache-2.0
"""MCAP: recordings as rosbag2 writes them."""
