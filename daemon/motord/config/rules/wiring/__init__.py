# SPDX-License-Identifier: Apache-2.0
"""Rules of lines, wires and pins."""
