# SPDX-License-Identifier: Apache-2.0
"""Calibrate geometry, dead band and gyro by measured drives: motord calibrate."""
