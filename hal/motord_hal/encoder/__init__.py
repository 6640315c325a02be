# SPDX-License-Identifier: Apache-2.0
"""Quadrature encoders on this machine: GPIO lines, and counters of the kernel, which
csrc/pwm/encoder.c reads."""
