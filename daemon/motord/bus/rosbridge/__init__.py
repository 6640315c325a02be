# SPDX-License-Identifier: Apache-2.0
"""A server for rosbridge: JSON over WebSocket."""
