# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the reference board. Files about other boards have their own `program` or `peer`."""

import pytest
from mcu_peer import McuPeer, compiled


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The reference board as a program that is compiled for this machine."""
    return compiled(tmp_path_factory.mktemp("board"))


@pytest.fixture
def peer(program, tmp_path):
    peer = McuPeer(program, tmp_path / "board")
    yield peer
    peer.pull()
