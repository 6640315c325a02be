# SPDX-License-Identifier: Apache-2.0
"""A joystick that is connected to this machine."""
