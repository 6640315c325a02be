# SPDX-License-Identifier: Apache-2.0
"""Turn one wheel at a time and correct the robot file by the result: motord spin."""
