# SPDX-License-Identifier: Apache-2.0
"""Commands as datagrams that the loop itself takes in, with the examples of docs/commands.md."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys

import pytest
from tests.sim.command_source import INPUTS, Source, free_udp_port, wheels_turn
from tests.sim.daemon_stage import RETRIED, ROBOT, ROOT, release_sources, running, wait_until

from motord.api.commands import RELEASE, datagram
from motord.client import ClientError, Refused
from motord.local_socket.server import CONNECTIONS_MAX
from motord_hal.realtime.exchange import now_ns


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rt-commands")
    robot = folder / "robot.toml"
    text = ROBOT.read_text(encoding="utf-8").split("[input.")[0]
    robot.write_text(text + INPUTS.format(port=free_udp_port()), encoding="utf-8")
    with running(folder, *RETRIED, robot=robot) as running_stage:
        running_stage.wait_for("idle")
        yield running_stage


def arm(stage):
    """Arm; reset a fault that a busy machine latched in the test before. Return whether armed."""
    with contextlib.suppress(Refused):
        if stage.state() == "fault":
            stage.robot.reset()
        if stage.state() == "idle":
            stage.robot.arm()
    return stage.state() == "armed"


@pytest.fixture
def armed(stage):
    wait_until(lambda: not stage.robot.status()["leases"], "no lease of the test before")
    wait_until(lambda: arm(stage), f"armed\n{stage.logged()}")
    release_sources(stage)
    yield stage
    stage.robot.stop()
    stage.robot.disarm()


def refused(stage):
    return stage.robot.status()["commands"]["refused"]


def test_a_datagram_turns_the_wheels_and_a_release_stops_them(armed):
    with Source(armed) as source:
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn")
        leases = armed.robot.status()["leases"]
        assert [(x["owner"], x["priority"], x["held"]) for x in leases] == [("socket", 50, False)]
        source.send(0.0, kind=RELEASE)
        wait_until(lambda: armed.sim.call("truth")["at_rest"], "rest")


def test_the_lease_ends_with_its_connection(armed):
    with Source(armed, owner="brief") as source:
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn")
    wait_until(lambda: armed.sim.call("truth")["at_rest"], "rest")
    before = refused(armed)["token"]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as late:
        late.connect(source.lease["socket"])
        token = bytes.fromhex(source.lease["token"])
        late.send(datagram(token, 10**6, now_ns(), 0.3, 0.0))
    wait_until(lambda: refused(armed)["token"] == before + 1, "it is refused")


def test_idle_connections_do_not_push_out_a_source_that_sends_datagrams(armed):
    with Source(armed, owner="old") as source, contextlib.ExitStack() as cleanup:
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn")
        idle = []
        for _ in range(CONNECTIONS_MAX + 8):
            opened = cleanup.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            opened.connect(str(armed.socket))
            opened.settimeout(0.0)
            idle.append(opened)
            source.send(0.3)
        wait_until(lambda: source.send(0.3) or sum(map(is_closed, idle)) > 8, "others make room")
        place_m = armed.sim.truth().distance_m
        wait_until(
            lambda: source.send(0.3) or armed.sim.truth().distance_m > place_m + 0.1, "it drives on"
        )


def is_closed(connection):
    try:
        return connection.recv(1, socket.MSG_PEEK) == b""
    except BlockingIOError:
        return False


def test_a_source_that_keeps_sending_through_a_stop_is_held_until_it_sends_zero(armed):
    with Source(armed, owner="stubborn") as source:
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn")
        armed.robot.stop()
        wait_until(lambda: source.send(0.3) or armed.sim.call("truth")["at_rest"], "rest")
        wait_until(lambda: armed.state() == "armed", "it is armed again")
        source.send(0.3)
        lease = wait_until(lambda: armed.robot.status()["leases"], "the lease")[0]
        assert (lease["owner"], lease["held"]) == ("stubborn", True)
        assert armed.sim.call("truth")["at_rest"]
        source.send(0.0)
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn again")


def test_the_higher_priority_commands_through_either_socket(armed):
    with Source(armed, owner="autopilot") as source, armed.client() as person:
        source.send(0.2)
        assert person.drive(0.0, 0.0, owner="person")["in_command"]  # priority 100 against 50
        source.send(0.3)
        leases = armed.robot.status()["leases"]
        assert [lease["owner"] for lease in leases] == ["person", "autopilot"]
        person.release("person")
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn")


def test_udp_on_this_machine_is_accepted_too(armed):
    with Source(armed, owner="udp") as source:
        source.to.close()
        source.to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        source.to.connect(("127.0.0.1", source.lease["udp_port"]))
        wait_until(lambda: source.send(0.3) or wheels_turn(armed), "the wheels turn")


def test_rubbish_is_counted_and_moves_nothing(armed):
    with Source(armed, owner="rubbish") as source:
        before = refused(armed)
        source.to.send(b"go!")
        source.to.send(os.urandom(64))
        source.send(0.3, token=bytes(16))
        source.send(0.3, stamp_ns=now_ns() - 10**10)
        source.send(float("nan"))
        wait_until(lambda: refused(armed)["not_finite"] > before["not_finite"], "all are counted")
        now = refused(armed)
        assert now["form"] == before["form"] + 2
        assert now["token"] == before["token"] + 1
        assert now["age"] == before["age"] + 1
        assert armed.sim.call("truth")["at_rest"]


def test_a_priority_above_the_robot_files_is_refused(stage):
    with stage.client() as greedy, pytest.raises(ClientError, match="above the robot file's 50"):
        greedy.call("lease", owner="greedy", priority=51)


@pytest.mark.parametrize("language", ["python", "c"])
def test_the_examples_of_the_docs_drive_the_robot(armed, tmp_path, language):
    armed.sim.call("reset_truth")
    if language == "python":
        command = [sys.executable, ROOT / "docs/send_command.py", armed.socket, "0.3", "0.0", "1.0"]
        run = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert run.returncode == 0, run.stderr
        assert run.stdout.endswith("commands\n")
    else:
        program = tmp_path / "send_command"
        flags = ["-std=c11", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror"]
        subprocess.run(
            [shutil.which("gcc") or "cc", *flags, "-o", program, ROOT / "docs/send_command.c"],
            check=True, timeout=60,
        )  # fmt: skip
        with Source(armed, owner="c") as source:
            run = subprocess.run(
                [program, source.lease["socket"], source.lease["token"], "0.3", "0.0", "50"],
                timeout=60,
            )
            assert run.returncode == 0
    assert armed.sim.call("truth")["moved_max_m_s"] > 0.1


def test_the_socket_file_is_removed_when_the_daemon_ends(tmp_path):
    robot = tmp_path / "robot.toml"
    text = ROBOT.read_text(encoding="utf-8").split("[input.")[0]
    robot.write_text(text + INPUTS.format(port=free_udp_port()), encoding="utf-8")
    with running(tmp_path, robot=robot, simulated=False) as brief:
        path = brief.robot.call("lease")["socket"]
        assert os.stat(path).st_mode & 0o777 == 0o660
        brief.end()
        assert not os.path.exists(path)
