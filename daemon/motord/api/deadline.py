# SPDX-License-Identifier: Apache-2.0
"""Deadlines for who may not see the hardware layer."""

from motord_hal.base.clock import within

__all__ = ["within"]
