# SPDX-License-Identifier: Apache-2.0
"""Full-screen views for a terminal (Textual): a client as any other, over the local socket."""
