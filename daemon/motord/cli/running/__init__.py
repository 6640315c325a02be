# SPDX-License-Identifier: Apache-2.0
"""Commands for a robot that runs: they talk to its daemon."""
