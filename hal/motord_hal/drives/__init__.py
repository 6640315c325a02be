# SPDX-License-Identifier: Apache-2.0
"""Drive profiles (config/drives/*.toml), their reader, and their conversions to SI units."""
