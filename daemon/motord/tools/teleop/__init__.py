# SPDX-License-Identifier: Apache-2.0
"""Drive by hand: a keyboard over SSH, or a gamepad at this machine."""
