# SPDX-License-Identifier: Apache-2.0
"""The daemon's process: it starts the parts, runs the tasks beside the loop and answers the local
socket."""
