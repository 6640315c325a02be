# SPDX-License-Identifier: Apache-2.0
"""Procedures that make a new robot ready to drive; they reach the user only through a `Person`."""
