# SPDX-License-Identifier: Apache-2.0
"""The modules for other programs: state, commands and stops of a running daemon. They need the
standard library alone."""
