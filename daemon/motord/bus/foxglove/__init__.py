# SPDX-License-Identifier: Apache-2.0
"""Foxglove: its own WebSocket server."""
