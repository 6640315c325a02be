# SPDX-License-Identifier: Apache-2.0
"""Hoverboard main boards with the FOC firmware, on a UART."""
