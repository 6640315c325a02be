# SPDX-License-Identifier: Apache-2.0
"""Deadlines for code that may not import the hardware layer."""

from motord_hal.base.clock import within

__all__ = ["within"]
