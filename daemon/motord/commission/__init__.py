# SPDX-License-Identifier: Apache-2.0
"""Procedures that bring a new robot to driving; `person` is all they know of a user."""
