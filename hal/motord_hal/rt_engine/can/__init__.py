# SPDX-License-Identifier: Apache-2.0
"""CAN lines whose cycle runs in C."""
