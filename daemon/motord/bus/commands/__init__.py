# SPDX-License-Identifier: Apache-2.0
"""Commands from any bus: who may give them, how old they are, and the lease they go under."""
