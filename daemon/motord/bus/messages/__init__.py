# SPDX-License-Identifier: Apache-2.0
"""What every bus carries: topics, and messages from a snapshot."""
