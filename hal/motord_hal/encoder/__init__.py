# SPDX-License-Identifier: Apache-2.0
"""Quadrature encoders on this machine: GPIO lines, and counters of the kernel. csrc/encoder.c reads
them."""
