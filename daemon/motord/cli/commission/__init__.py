# SPDX-License-Identifier: Apache-2.0
"""Commands that find drives, and measure and set up a robot."""
