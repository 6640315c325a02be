# SPDX-License-Identifier: Apache-2.0
"""Whatever ends motord-bus while it commands: its lease lapses, the robot rests, loop and lines go
on, and another motord-bus starts soon. `make bench` measures the loop's lateness meanwhile: it
would mean nothing on the busy machine of these tests."""

import os
import signal

import pytest
from tests.long_cases import long_but
from tests.sim.daemon_stage import obeying, running, wait_until
from tests.sim.planted import Planted

BACK_WITHIN_S = 60.0
"""Longest time until another motord-bus runs; one that hangs is replaced after 2 s."""
FORK_FAULTS = 600
"""Page faults of the loop that one fork of the daemon would cause (docs/architecture.md)."""
CYCLES = 20
FAULTS = {
    "SIGKILL": "was ended by SIGKILL",
    "SIGSTOP": "was silent",
    "segfault": "was ended by SIGSEGV",
    "leak": "MemoryError",
    "loop": "was silent",
}
"""Text that each fault leaves in the log."""


@pytest.fixture
def planted(tmp_path):
    return Planted(tmp_path)


@pytest.fixture
def stage(tmp_path, planted):
    settings = (*planted.settings, "safety.command_timeout_s=1.0",
                "joint.left.tries=10", "joint.right.tries=10")  # fmt: skip
    with running(tmp_path, *settings, environ=planted.environ) as stage:
        stage.wait_for("idle")
        yield stage


def leasing(stage, but=None):
    """Return the process number of motord-bus, once it has a lease; not the number `but`."""

    def found():
        now = stage.robot.status()["bus"]
        lease = now.get("inputs", {}).get("planted", {}).get("lease")
        return now["pid"] not in (None, but) and lease and now["pid"]

    return wait_until(found, f"motord-bus\n{stage.logged()}", BACK_WITHIN_S)


def exchanges(stage):
    return sum(line["exchanges"] for line in stage.robot.status()["lines"].values())


@pytest.mark.parametrize("fault", long_but(("SIGKILL",), FAULTS))
def test_a_fault_in_motord_bus_ends_its_lease_and_the_robot_rests(stage, planted, fault):
    pid = leasing(stage)
    obeying(stage, lambda may: planted.order("drive") if may else planted.rest())
    loop = stage.robot.status()["loop"]
    if fault.startswith("SIG"):
        os.kill(pid, signal.Signals[fault])
        planted.rest()
    else:
        planted.order(fault)
    wait_until(lambda: not stage.robot.status()["leases"], "no source in command")
    wait_until(lambda: stage.robot.status()["at_rest"], "rest")
    sent = exchanges(stage)
    wait_until(lambda: exchanges(stage) > sent + CYCLES, "lines that go on")
    accepted = stage.robot.status()["commands"]["accepted"]
    assert leasing(stage, but=pid) != pid
    after = stage.robot.status()
    assert FAULTS[fault] in stage.logged()
    assert after["at_rest"], "it does not move again by itself"
    assert after["commands"]["accepted"] == accepted
    assert after["bus"]["restarts"] == 1
    assert after["loop"]["ticks"] > loop["ticks"]
    assert after["loop"]["page_faults"] - loop["page_faults"] < FORK_FAULTS / 2
    sent = exchanges(stage)
    wait_until(lambda: exchanges(stage) > sent + CYCLES, "lines that go on")
