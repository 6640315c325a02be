# SPDX-License-Identifier: Apache-2.0
"""Tools that measure and show motord. Nothing here runs inside the daemon."""
