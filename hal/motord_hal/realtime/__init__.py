# SPDX-License-Identifier: Apache-2.0
"""The C extension: exchange and the threads of lines. Nothing else in the hardware layer imports
it."""
