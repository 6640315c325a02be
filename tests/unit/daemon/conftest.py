# SPDX-License-Identifier: Apache-2.0
"""What tests of the local socket share."""

import pytest


@pytest.fixture
def path(tmp_path):
    """Where a daemon makes its socket. A file that needs another path has its own fixture."""
    return tmp_path / "robot.sock"
