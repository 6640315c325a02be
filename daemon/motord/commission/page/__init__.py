# SPDX-License-Identifier: Apache-2.0
"""The guided procedures for the dashboard, in a process of their own."""
