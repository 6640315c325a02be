# SPDX-License-Identifier: Apache-2.0
"""Geometry, dead band and gyro from measured drives: motord calibrate."""
