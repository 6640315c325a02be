# SPDX-License-Identifier: Apache-2.0
"""`motord params save` with a running daemon, at a real terminal."""

import pytest
from tests.sim.person_stage import at_terminal, copied, robot_of

from motord.config import load_robot


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("save")
    file = copied(folder)
    with robot_of(folder, file) as stage:
        stage.file = file
        yield stage


def backups(stage):
    return list(stage.file.parent.glob("*.bak"))


def test_nothing_is_written_without_a_yes(stage):
    before, kept = stage.file.read_bytes(), backups(stage)
    stage.robot.params_set(**{"limits.linear_m_s": 0.7}, force=True)
    with at_terminal("params", "save", "--socket", stage.socket) as screen:
        screen.answer(r"\+linear_m_s = 0.7\n(.*\n)*Write .*cart.toml\? ", "n")
        assert screen.end() == 0
    assert "nothing was written" in screen.text
    assert stage.file.read_bytes() == before
    assert backups(stage) == kept


def test_what_was_set_is_written_after_a_yes(stage):
    before, kept = stage.file.read_bytes(), backups(stage)
    stage.robot.params_set(**{"limits.linear_m_s": 0.6, "limits.angular_rad_s3": None}, force=True)
    with at_terminal("params", "save", "--socket", stage.socket) as screen:
        screen.answer(r"\+linear_m_s = 0.6\n(.*\n)*Write .*cart.toml\? ", "y")
        assert screen.end() == 0
    limits = load_robot(stage.file).limits
    assert (limits.linear_m_s, limits.angular_rad_s3) == (0.6, float("inf"))
    [backup] = set(backups(stage)) - set(kept)
    assert backup.read_bytes() == before


def test_a_value_that_is_not_a_number_is_refused_with_range_and_unit(stage):
    with at_terminal("params", "set", "limits.linear_m_s=fast", "--socket", stage.socket) as screen:
        assert screen.end() == 2
    assert "'fast' is not a number, as 0.3 or inf (no limit) (0.001 to " in screen.text
