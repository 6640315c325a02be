# SPDX-License-Identifier: Apache-2.0
"""What tests against other people's programs share."""

import pytest
from tests.peers.mqtt.mosquitto import free_port


@pytest.fixture(scope="module")
def port():
    """A free port for the server of this file's robot."""
    return free_port()
