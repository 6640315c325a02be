# SPDX-License-Identifier: Apache-2.0
"""The drive profiles of the project, each read once in a process: most tests of drives need one."""

import functools

from motord.config.drives.load import find_profile, list_profiles

NAMES = tuple(list_profiles())
shipped_profile = functools.cache(find_profile)
"""Returns the profile of a name. It is immutable; `dataclasses.replace` makes changed copies."""
