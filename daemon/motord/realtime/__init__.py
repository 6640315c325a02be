# SPDX-License-Identifier: Apache-2.0
"""The C extension: core, loop and state page. Nothing else in the daemon
imports it."""
