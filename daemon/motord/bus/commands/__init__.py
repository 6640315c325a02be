# SPDX-License-Identifier: Apache-2.0
"""Commands from any bus: their token, their age, and their lease."""
