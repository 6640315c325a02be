# SPDX-License-Identifier: Apache-2.0
"""The questions of motord init, and the robot file that follows from the answers."""
