# SPDX-License-Identifier: Apache-2.0
"""Topics that every bus carries, and messages made from a snapshot."""
