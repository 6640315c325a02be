# SPDX-License-Identifier: Apache-2.0
"""motord: motors on RS485, CAN and PWM as one robot base."""
