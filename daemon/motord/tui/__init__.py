# SPDX-License-Identifier: Apache-2.0
"""Full-screen views for a terminal (Textual), as ordinary clients of the local socket."""
