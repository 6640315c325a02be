# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests against programs of other projects."""

import pytest
from tests.peers.mqtt.mosquitto import free_port


@pytest.fixture(scope="module")
def port():
    """A free TCP port, for a server of the robot of one test file."""
    return free_port()
