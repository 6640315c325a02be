# SPDX-License-Identifier: Apache-2.0
"""A line and its simulated drives. Each file defines `variant`, the name of a profile and its
engine, and `profile`, the profile of that variant."""

import pytest
from loop_side import running
from sim_bench import folder_of, spec_of


@pytest.fixture
def folder(variant, tmp_path):
    return folder_of(variant, tmp_path)


@pytest.fixture
async def rig(profile, sim, folder):
    async with running(spec_of(profile, folder)) as rig:
        yield rig
