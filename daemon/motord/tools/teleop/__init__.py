# SPDX-License-Identifier: Apache-2.0
"""Driving by hand, with a keyboard over SSH or a gamepad at this machine."""
