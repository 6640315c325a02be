# SPDX-License-Identifier: Apache-2.0
"""Lines whose cycle runs in asyncio: the parts that do not depend on the wire."""
