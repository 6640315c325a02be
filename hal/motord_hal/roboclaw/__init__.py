# SPDX-License-Identifier: Apache-2.0
"""RoboClaw motor controllers in packet serial mode."""
