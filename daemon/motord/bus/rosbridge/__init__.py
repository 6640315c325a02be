# SPDX-License-Identifier: Apache-2.0
"""rosbridge: JSON over WebSocket."""
