# SPDX-License-Identifier: Apache-2.0
"""Motor bridges on PWM channels and GPIO lines of this machine."""
