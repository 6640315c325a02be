# SPDX-License-Identifier: Apache-2.0
"""The daemon's report of missing safety pins."""

import subprocess
import sys

from tests.sim.daemon_stage import ROBOT, ROOT

DEADLINE_S = 60.0


def test_a_robot_without_its_emergency_stop_pin_is_not_started(tmp_path):
    settings = ("safety.estop.gpio_chip=no-such-chip", "safety.estop.gpio_line=E")
    ended = subprocess.run(
        [sys.executable, "-m", "motord", "run", str(ROBOT), "--socket", str(tmp_path / "sock"),
         *(part for setting in settings for part in ("--set", setting))],
        capture_output=True, text=True, timeout=DEADLINE_S, cwd=ROOT,
    )  # fmt: skip
    assert ended.returncode == 3
    assert 'no GPIO chip "no-such-chip"' in ended.stderr
    assert not (tmp_path / "sock").exists()
