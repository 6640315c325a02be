# SPDX-License-Identifier: Apache-2.0
"""The local socket: which processes may call, what can be called, and the answers."""
