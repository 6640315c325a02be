# SPDX-License-Identifier: Apache-2.0
"""Boards that take their set-points as lines of text."""
