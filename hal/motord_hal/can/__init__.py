# SPDX-License-Identifier: Apache-2.0
"""CAN buses: frames, the cyclic table of a drive, and the line on asyncio."""
