# SPDX-License-Identifier: Apache-2.0
"""Lines whose cycle runs in C: here they are planned, opened, set up, armed and watched."""
