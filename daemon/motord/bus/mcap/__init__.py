# SPDX-License-Identifier: Apache-2.0
"""Recordings in MCAP files, in the form of rosbag2."""
