# SPDX-License-Identifier: Apache-2.0
"""The daemon is killed at full speed under systemd, for each kind of line: the wheels come to
rest, and the daemon returns disarmed. Each test prints the times for a row of docs/safety.md."""

import os
import signal
import time

import pytest
from shell import output, wait_until
from unit import prepared, started
from unit_robots import KINDS

SMOKE = pytest.param("pwm", marks=pytest.mark.smoke)
"""The fastest kind, because it needs no simulator that has to keep time."""


@pytest.mark.parametrize("kind", [SMOKE, *(kind for kind in KINDS if kind != "pwm")])
def test_the_wheels_of_a_killed_daemon_rest_and_it_returns_disarmed(kind, capsys):
    name = f"killed-{kind}"
    with (
        KINDS[kind](name) as (sim, robot),
        prepared(name, f"WatchdogSec=90\n{output('motord', 'unit', str(robot))}"),
        started(name, sim) as unit,
    ):
        sent_before, pid = unit.logged().count("without power"), unit.main_pid()
        unit.drive_on(0.4)
        killed_s = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        assert not sim.truth().at_rest
        wait_until(lambda: sim.truth().at_rest, "the wheels rest", unit.logged)
        rest_s = time.monotonic() - killed_s
        unit.again(pid).wait_for("idle")
        back_s = time.monotonic() - killed_s
        assert unit.rests_without_power()
        logged = unit.logged()
        assert logged.count("without power") == sent_before + 1, logged
    with capsys.disabled():
        print(f"\n{kind}: kill -9: at rest after {rest_s:.1f} s, idle after {back_s:.1f} s")
