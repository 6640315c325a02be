# SPDX-License-Identifier: Apache-2.0
"""The search for what made ticks late."""
