# SPDX-License-Identifier: Apache-2.0
"""Commands from any bus: their tokens, their ages, and their leases."""
