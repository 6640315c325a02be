# SPDX-License-Identifier: Apache-2.0
"""The dashboard: a page for browsers, its stream of states, and its commands."""
