# SPDX-License-Identifier: Apache-2.0
"""Access to the C extension: core, loop and state page. No other package of the daemon imports the
extension."""
