# SPDX-License-Identifier: Apache-2.0
"""Drives as data: profiles (config/drives/*.toml), their reader, and what a profile means in SI."""
