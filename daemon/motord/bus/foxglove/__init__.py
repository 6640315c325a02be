# SPDX-License-Identifier: Apache-2.0
"""A WebSocket server for Foxglove."""
