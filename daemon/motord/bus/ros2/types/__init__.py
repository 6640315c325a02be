# SPDX-License-Identifier: Apache-2.0
"""ROS 2 types: definitions, hashes and CDR."""
