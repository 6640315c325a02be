# SPDX-License-Identifier: Apache-2.0
"""A joystick at this machine."""
