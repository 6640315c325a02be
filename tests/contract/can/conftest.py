# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of lines in C. Tests that also run in the guest of `make vm` have fixtures
in their own files: the guest has no conftest.py of this folder."""

import pytest
from can_rt_rig import Bus


@pytest.fixture
def bus(tmp_path):
    """A bus that is read only when the test calls a method."""
    bus = Bus(tmp_path)
    yield bus
    bus.close()
