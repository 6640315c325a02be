# SPDX-License-Identifier: Apache-2.0
"""The tables of a joint, and what it and its drive can do."""
