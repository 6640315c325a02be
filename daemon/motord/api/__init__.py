# SPDX-License-Identifier: Apache-2.0
"""What other programs import: state, commands and stops of a running daemon. It needs the
standard library alone."""
