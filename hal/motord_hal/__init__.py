# SPDX-License-Identifier: Apache-2.0
"""motord's hardware layer: lines, drive profiles, simulated drives. It imports nothing from the
daemon."""
