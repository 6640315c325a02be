# SPDX-License-Identifier: Apache-2.0
"""Lines whose cycle runs in asyncio: what they share, whatever their wire."""
