# SPDX-License-Identifier: Apache-2.0
"""Fixtures that reset the robot between tests. Each test file has its own `stage`."""

import pytest
from tests.peers.ros2.ros2_stage import called, settle
from tests.sim.daemon_stage import release_sources, wait_until


@pytest.fixture
def settled(stage):
    settle(stage)


@pytest.fixture
def armed(stage, settled):
    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    yield stage
    settle(stage)
