# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests of the local socket."""

import pytest


@pytest.fixture
def path(tmp_path):
    """Path of a daemon's socket. A file of tests that needs another path has its own fixture."""
    return tmp_path / "robot.sock"
