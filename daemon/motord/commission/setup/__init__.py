# SPDX-License-Identifier: Apache-2.0
"""Questions, and the robot file that follows from the answers: motord init."""
