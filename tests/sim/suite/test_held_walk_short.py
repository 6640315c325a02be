# SPDX-License-Identifier: Apache-2.0
"""A short form of the random walk of tests/soak/held_walk.py."""

import pytest
from tests.soak.held_walk import walk

SECONDS = 600.0
"""Only a hung walk takes longer."""


@pytest.mark.long
@pytest.mark.parametrize("robot", ["demo", "pan-tilt"])
def test_no_joint_moves_after_a_stop_however_late_its_sources_are(tmp_path, robot):
    steps, violations = walk(robot, 39, 4, SECONDS, tmp_path)
    assert violations == []
    assert steps == 4
