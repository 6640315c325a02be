# SPDX-License-Identifier: Apache-2.0
"""The reference board. Files about other boards have a `program` or a `peer` of their own."""

import pytest
from mcu_peer import McuPeer, compiled


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """Compiled for this machine."""
    return compiled(tmp_path_factory.mktemp("board"))


@pytest.fixture
def peer(program, tmp_path):
    peer = McuPeer(program, tmp_path / "board")
    yield peer
    peer.pull()
