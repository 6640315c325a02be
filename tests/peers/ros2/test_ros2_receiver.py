# SPDX-License-Identifier: Apache-2.0
"""cmd_vel without Python: C code in motord-bus passes it from DDS to the daemon."""

import os
import signal
import time
from pathlib import Path

import pytest
from tests.peers.ros2.ros2_stage import NAMESPACE, called, inputs, peer, ros2_stage
from tests.sim.daemon_stage import release_sources, wait_until

from motord.bus.confine import REALTIME_PRIORITY_MAX
from motord.bus.ros2.dds.priority import set_policy

pytest.importorskip("cyclonedds", reason="needs cyclonedds")
pytestmark = pytest.mark.usefixtures("settled")

TOPIC = f"rt{NAMESPACE}/cmd_vel"
HOGS = 4
BURST, BURSTS = 5, 20


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    environ = {"PYTHONPATH": str(Path(__file__).with_name("hogged")), "HOGS": str(HOGS)}
    with ros2_stage(tmp_path_factory.mktemp("receiver"), environ=environ) as stage:
        yield stage


def threads(pid):
    return len(os.listdir(f"/proc/{pid}/task"))


def bus(stage):
    return stage.robot.status()["bus"]["pid"]


def judged(stage):
    """Return the number of commands at the daemon's loop without old ones, and that of old ones."""
    commands = stage.robot.status()["commands"]
    old = commands["refused"]["age"]
    return commands["accepted"] + sum(commands["refused"].values()) - old, old


def ours(stage):
    return inputs(stage)["ros2"]


def test_c_receives_the_commands(stage):
    assert "goes through Python" not in stage.logged()


def test_only_the_receiving_thread_has_real_time_priority(stage):
    """LimitRTPRIO of the systemd unit permits that priority. Here the test sets it from outside."""
    set_policy(os.SCHED_FIFO, REALTIME_PRIORITY_MAX, bus(stage))
    tasks = Path(f"/proc/{bus(stage)}/task").iterdir()
    found = {
        ((task / "comm").read_text().strip(), os.sched_getscheduler(int(task.name)))
        for task in tasks
    }
    before_python = {name for name, policy in found if policy != os.SCHED_OTHER}
    if not before_python:
        pytest.skip("needs the right to SCHED_FIFO")
    assert before_python == {"recv"}


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("drive", TOPIC, 0.3, 0.0, "zero"), "its stamp is zero"),
        (("drive", TOPIC, 0.3, 0.0, -3600), "its stamp is in the future"),
        (("frame", TOPIC, 5000), "it is no geometry_msgs/msg/TwistStamped"),
    ],
    ids=["no stamp", "ahead", "too long"],
)
def test_a_command_refused_by_the_gate_is_counted_and_moves_nothing(stage, words, why):
    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    before, x_m = ours(stage)["refused"], stage.sim.truth().x_m

    def refused(count):
        return wait_until(lambda: (now := ours(stage))["refused"] > before + count and now, why)

    with peer(*words):  # the first count may be from the test before
        assert refused(0)["sent"] == refused(5)["sent"]
    assert stage.sim.truth().x_m == x_m


@pytest.mark.parametrize(
    ("speed", "age_s", "reason"),
    [("nan", 0, "not_finite"), ("-inf", 0, "not_finite"), (1e308, 0, "out_of_range"),
     (0.3, 60, "age")],
)  # fmt: skip
def test_a_command_refused_by_the_daemon_is_counted_there_and_moves_nothing(
    stage, speed, age_s, reason
):
    def refused():
        return stage.robot.status()["commands"]["refused"][reason]

    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    before, x_m = refused(), stage.sim.truth().x_m
    with peer("drive", TOPIC, speed, 0.0, age_s):
        wait_until(lambda: refused() > before + 5, reason)
    assert stage.sim.truth().x_m == x_m


def test_commands_by_dds_and_by_python_go_out_under_one_lease(stage):
    """Joint commands pass through Python, cmd_vel through C. No sequence number is used twice."""

    def out_of_order():
        return stage.robot.status()["commands"]["refused"]["sequence"]

    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    before, sent = out_of_order(), ours(stage)["sent"]
    with (
        peer("drive", TOPIC, 0.1, 0.0),
        peer("joints", f"rt{NAMESPACE}/joint_commands", "right=1.0", "left=1.0"),
    ):
        wait_until(lambda: ours(stage)["sent"] > sent + 50, "commands")
    assert out_of_order() == before


def test_commands_stop_while_python_stands_still_and_resume_with_it(stage):
    """A process whose Python is blocked would not receive an emergency stop by ROS 2."""

    def accepted():
        return stage.robot.status()["commands"]["accepted"]

    wait_until(lambda: called("arm")["success"], "armed")
    release_sources(stage)
    lost = ours(stage)["lost"]
    with peer("drive", TOPIC, 0.3, 0.0):
        wait_until(lambda: not stage.robot.status()["at_rest"], "it drives")
        pid = bus(stage)
        os.kill(pid, signal.SIGWINCH)
        try:
            wait_until(lambda: stage.robot.status()["at_rest"], "no source commands")
            before = accepted()
        finally:
            os.kill(pid, signal.SIGUSR2)
        wait_until(lambda: accepted() > before + 5, "commands go on")
    assert bus(stage) == pid
    wait_until(lambda: ours(stage)["lost"] > lost, "the lost commands are counted")


@pytest.fixture
def busy(stage):
    """Keep motord-bus busy with threads of pure Python."""
    pid = bus(stage)
    before = threads(pid)
    os.kill(pid, signal.SIGUSR1)
    wait_until(lambda: threads(pid) >= before + HOGS, "busy threads")
    yield
    os.kill(pid, signal.SIGUSR2)


def pass_through(stage, writer):
    """Wait until a command of this writer reaches the daemon. The writer may have found the reader
    before the reader has found it, and a lease may still be missing. The writer sends old commands
    until one is refused: old ones are not counted with the bursts. It sends one a second, because
    the reader keeps 8 samples, and old ones must not fill these before a burst."""
    writer.find(lambda word: word == "received", "a reader")
    before, next_s = judged(stage)[1], 0.0

    def arrived():
        nonlocal next_s
        if time.monotonic() >= next_s:
            next_s = time.monotonic() + 1.0
            writer.say("old")
        return judged(stage)[1] > before

    wait_until(arrived, "a command that reaches the daemon")


def test_busy_python_in_motord_bus_loses_no_command(stage, busy):
    with peer("bursts", TOPIC, 0.1, BURST) as writer:
        pass_through(stage, writer)
        begun, lost = judged(stage)[0], ours(stage)["lost"]
        for number in range(1, BURSTS + 1):
            writer.say("go")
            there = begun + number * BURST
            wait_until(lambda there=there: judged(stage)[0] >= there, f"burst {number}")
    assert judged(stage)[0] == begun + BURST * BURSTS
    assert ours(stage)["lost"] == lost
