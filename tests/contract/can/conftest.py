# SPDX-License-Identifier: Apache-2.0
"""What the tests of lines in C share. Tests that run in the guest of `make vm`, too, have their
fixtures in their own files: the guest has no conftest.py of this folder."""

import pytest
from can_rt_rig import Bus


@pytest.fixture
def bus(tmp_path):
    """Read when the test calls for it."""
    bus = Bus(tmp_path)
    yield bus
    bus.close()
