# SPDX-License-Identifier: Apache-2.0
"""Fixtures that tests of whole robots share. Each file defines its own `stage`."""

import pytest
from tests.sim.daemon_stage import ROBOT, armed


@pytest.fixture(name="armed")
def _armed(stage):
    with armed(stage):
        yield stage


@pytest.fixture
def where_it_looks(tmp_path, monkeypatch):
    """The folder in which commands look for running robots."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = tmp_path / "motord"
    folder.mkdir(mode=0o700)
    return folder


@pytest.fixture
def own_file(tmp_path):
    """A copy of the robot file, for a test to edit."""
    robot = tmp_path / "own.toml"
    robot.write_text(ROBOT.read_text(encoding="utf-8"), encoding="utf-8")
    return robot
