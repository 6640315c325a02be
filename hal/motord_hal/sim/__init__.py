# SPDX-License-Identifier: Apache-2.0
"""A simulated robot: motors with mass and friction, behind drives that speak the real protocol."""
