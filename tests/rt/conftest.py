# SPDX-License-Identifier: Apache-2.0
"""Property tests here have no deadline: a busy machine is no bug of the core."""

from hypothesis import settings

settings.register_profile("rt", deadline=None)
settings.load_profile("rt")
