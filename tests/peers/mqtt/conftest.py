# SPDX-License-Identifier: Apache-2.0
"""The MQTT broker of these tests, which takes clients without a password."""

import pytest
from tests.peers.mqtt.mosquitto import broker


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    with broker(tmp_path_factory.mktemp("broker"), "allow_anonymous true") as made:
        yield made
