# SPDX-License-Identifier: Apache-2.0
"""Access to the C extension: the exchange and the threads of lines. No other package of the
hardware layer imports the extension."""
