# SPDX-License-Identifier: Apache-2.0
"""Lines whose cycle runs in C. Python plans, opens, sets up, arms and watches them."""
