# SPDX-License-Identifier: Apache-2.0
"""Who may command, by which bus. All of them command under a lease of the daemon's."""
