# SPDX-License-Identifier: Apache-2.0
"""The drive profiles: config/drives/NAME.toml, read and checked."""
