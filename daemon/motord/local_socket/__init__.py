# SPDX-License-Identifier: Apache-2.0
"""The local socket: who may call, what can be called, and the answers."""
