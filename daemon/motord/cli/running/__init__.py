# SPDX-License-Identifier: Apache-2.0
"""Commands that use the daemon of a running robot."""
