# SPDX-License-Identifier: Apache-2.0
"""The local socket: who may ask, what can be asked, and the answers."""
