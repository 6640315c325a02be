# SPDX-License-Identifier: Apache-2.0
"""What all lines have in common, whatever their medium and engine."""
