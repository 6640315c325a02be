# SPDX-License-Identifier: Apache-2.0
"""motord's hardware layer: lines, drives as data, simulated drives. Imports nothing of the
daemon."""
