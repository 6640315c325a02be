# SPDX-License-Identifier: Apache-2.0
"""The last line of the log claims neither power nor rest that nothing reports."""

from tests.sim.daemon_stage import ROOT, running


def test_the_end_names_a_board_that_reports_nothing(tmp_path):
    with running(tmp_path, robot=ROOT / "config/robots/sabertooth.toml") as stage:
        stage.wait_for("idle")
        stage.end()
        (last,) = [line for line in stage.logged().splitlines() if "ended: " in line]
    assert "the power-off of left, right was sent: nothing reports" in last
    assert "nothing measures whether left and right turn" in last
    assert "at rest and disarmed" not in last
