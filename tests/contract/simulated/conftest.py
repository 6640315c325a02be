# SPDX-License-Identifier: Apache-2.0
"""A line and its simulated drives. `variant` is the name of a profile and its engine, by which
tests are parametrized, and `profile` the profile of that variant; some files define their own."""

import pytest
from left_running import profile_of
from loop_side import running
from sim_bench import folder_of, spec_of


@pytest.fixture
def variant(request):
    return request.param


@pytest.fixture
def profile(variant):
    return profile_of(variant)


@pytest.fixture
def folder(variant, tmp_path):
    return folder_of(variant, tmp_path)


@pytest.fixture
async def rig(profile, sim, folder):
    async with running(spec_of(profile, folder)) as rig:
        yield rig
