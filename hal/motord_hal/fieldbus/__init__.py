# SPDX-License-Identifier: Apache-2.0
"""The part that all lines share, on each medium and engine."""
