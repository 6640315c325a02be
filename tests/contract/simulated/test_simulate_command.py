# SPDX-License-Identifier: Apache-2.0
"""`motord simulate` as a process, and its control socket."""

import contextlib
import json
import os
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sim_bench import ARRIVAL_DEADLINE_S

from motord.config import load_robot
from motord.tools.simulator import start_simulator
from motord_hal.modbus.codec import Function, Request, build_request, parse_reply, reply_bytes
from motord_hal.sim.control import ControlError, SimControl
from motord_hal.sim.fault_kinds import list_kinds

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "config/robots/demo.toml"
VELOCITIES = Request(1, Function.READ_HOLDING, 0x20AB, 2)


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim")
    with start_simulator(DEMO, faults=("drop:unit=1,nth=1000000",), seed=5, link_dir=folder) as sim:
        yield sim


def ask(port, request):
    fd = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(fd, build_request(request))
        data = b""
        while len(data) < reply_bytes(request):
            assert select.select([fd], [], [], ARRIVAL_DEADLINE_S)[0], "no answer"
            data += os.read(fd, 256)
        return parse_reply(request, data)
    finally:
        os.close(fd)


@contextlib.contextmanager
def simulate(*arguments):
    with subprocess.Popen(
        [sys.executable, "-m", "motord", "simulate", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def test_its_first_line_reports_where_everything_is(sim, tmp_path_factory):
    assert sim.robot == "demo"
    assert sim.seed == 5
    assert sim.ports.keys() == {"rs485"}
    assert Path(sim.ports["rs485"]).is_symlink()
    assert Path(sim.control_path).stat().st_mode & 0o777 == 0o600


def test_its_drives_answer_on_that_port(sim):
    assert ask(sim.ports["rs485"], VELOCITIES).values == (0, 0)


def test_its_truth_names_every_joint_of_the_robot(sim):
    truth = sim.control.truth()
    assert truth.joints.keys() == {"left", "right"}
    assert truth.at_rest
    assert not any(joint.enabled for joint in truth.joints.values())
    later = sim.control.truth()
    assert later.rest_since_s >= truth.rest_since_s
    sim.control.reset_truth()
    assert sim.control.truth().distance_m == 0.0


def test_faults_come_and_go_through_the_socket(sim):
    sim.control.inject("drop:p=0")
    specs = [fault["spec"] for fault in sim.control.stats()["faults"]]
    assert specs[-1] == "drop:p=0"
    assert sim.control.stats()["seed"] == 5
    sim.control.clear_faults_script()
    assert sim.control.stats()["faults"] == []


def test_a_pulled_port_is_gone_until_it_is_plugged(sim):
    port = Path(sim.ports["rs485"])
    sim.control.pull("rs485")
    assert not port.is_symlink()
    sim.control.plug("rs485")
    assert ask(port, VELOCITIES).values == (0, 0)


@pytest.mark.parametrize(
    ("method", "params", "says"),
    [
        ("inject", {"spec": "dorp"}, "did you mean drop"),
        ("inject", {"spec": "drop:unit=99"}, "no unit 99"),
        ("inject", {}, "spec"),
        ("pull", {"line": "can0"}, "known: rs485"),
        ("fly", {}, "known: truth"),
    ],
)
def test_a_refusal_gives_its_reason(sim, method, params, says):
    with pytest.raises(ControlError, match=says):
        sim.control.call(method, **params)
    assert sim.control.truth().at_rest


@pytest.mark.parametrize("line", [b"\n", b"[]\n", b"{\n", b"\xff\n", b'{"method": 3}\n', b"7\n"])
def test_garbage_on_the_socket_is_answered_with_an_error(sim, line):
    with socket.socket(socket.AF_UNIX) as raw:
        raw.settimeout(ARRIVAL_DEADLINE_S)
        raw.connect(sim.control_path)
        raw.sendall(line)
        assert "error" in json.loads(raw.recv(4096))
    assert sim.control.truth().at_rest


def test_a_client_that_sends_continuously_is_dropped(sim):
    with socket.socket(socket.AF_UNIX) as raw:
        raw.settimeout(ARRIVAL_DEADLINE_S)
        raw.connect(sim.control_path)
        with pytest.raises(OSError):
            while True:
                raw.sendall(b"x" * 65536)
    assert sim.control.truth().at_rest


def test_it_ends_with_its_parent_and_removes_its_ports(tmp_path):
    with simulate(str(DEMO), "--json", "--stop-on-eof", "--link-dir", str(tmp_path)) as process:
        hello = json.loads(process.stdout.readline())
        assert Path(hello["ports"]["rs485"]).is_symlink()
        process.stdin.close()
        assert process.wait(ARRIVAL_DEADLINE_S) == 0
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(tmp_path, number):
    with simulate(str(DEMO), "--control", str(tmp_path / "control.sock")) as process:
        printed = [process.stdout.readline() for _ in range(3)]
        assert "control socket" in printed[0]
        assert "--set line.rs485.port=" in printed[2]
        port = printed[1].split()[-1]
        assert Path(port).is_symlink()
        process.send_signal(number)
        assert process.wait(ARRIVAL_DEADLINE_S) == 0
        assert not Path(port).parent.exists()


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        ((str(DEMO), "--fault", "drop:p=2"), 2, "not in 0 to 1"),
        ((str(DEMO), "--seed", "-1"), 2, "--seed"),
        (("nowhere.toml",), 2, "nowhere.toml"),
        ((str(DEMO), "--control", "/proc/no.sock"), 1, "/proc/no.sock"),
    ],
)
def test_a_robot_that_cannot_be_simulated_is_reported_with_its_status(arguments, status, says):
    with simulate(*arguments) as process:
        errors = process.stderr.read()
        assert process.wait(ARRIVAL_DEADLINE_S) == status
    assert says in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize("taken", ["rs485", "control.sock"])
def test_a_foreign_file_is_not_replaced(tmp_path, taken):
    (tmp_path / taken).write_text("mine", encoding="ascii")
    with simulate(str(DEMO), "--link-dir", str(tmp_path)) as process:
        errors = process.stderr.read()
        assert process.wait(ARRIVAL_DEADLINE_S) == 1
    assert f"{tmp_path}/{taken}" in errors
    assert (tmp_path / taken).read_text(encoding="ascii") == "mine"


def test_files_that_a_killed_simulator_left_are_replaced(tmp_path):
    arguments = (str(DEMO), "--json", "--link-dir", str(tmp_path))
    with simulate(*arguments) as killed:
        killed.stdout.readline()
    with simulate(*arguments) as process:
        hello = json.loads(process.stdout.readline())
        assert ask(hello["ports"]["rs485"], VELOCITIES).values == (0, 0)


def test_a_simulator_that_does_not_start_is_an_error():
    with pytest.raises(ControlError, match=r"did not start.*nowhere\.toml"):
        start_simulator(ROOT / "nowhere.toml")


def test_a_missing_simulator_is_an_error_that_names_the_path(tmp_path):
    with pytest.raises(ControlError, match=r"gone\.sock"):
        SimControl(tmp_path / "gone.sock")


def test_a_simulator_that_hangs_is_an_error_in_time(tmp_path):
    with socket.socket(socket.AF_UNIX) as mute:
        mute.bind(str(tmp_path / "mute.sock"))
        mute.listen()
        started = time.monotonic()
        with (
            SimControl(tmp_path / "mute.sock", timeout_s=0.2) as control,
            pytest.raises(ControlError, match="does not answer"),
        ):
            control.truth()
        assert time.monotonic() - started >= 0.2


def printed(*arguments):
    command = [sys.executable, "-m", "motord", "simulate", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=ROOT, timeout=60, check=False
    )


def test_it_lists_its_faults_for_people_and_for_programs():
    kinds = json.loads(printed("--list-faults", "--json").stdout)
    assert kinds == list_kinds()
    assert kinds["noise"]["keys"]["ber"]["default"] == 1e-4
    assert {kind["happens"] for kind in kinds.values()} == {"reply", "state", "once"}
    text = printed("--list-faults").stdout
    assert all(f"{name}: {kind['text']}" in text for name, kind in kinds.items())


def test_its_page_and_its_help_name_every_fault():
    page = (ROOT / "docs/simulator.md").read_text()
    described = re.findall(r"^\| `([a-z-]+)[:`]", page, re.MULTILINE)
    assert set(list_kinds()) <= set(described)
    words = printed("--help").stdout
    assert all(name in " ".join(words.split()) for name in list_kinds())


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "Missing argument"),
        ((DEMO, "--tcp", "1502", "--rtu-over-tcp", "1503"), "either --tcp or"),
        ((DEMO, "--tcp", "here"), "expected [HOST:]PORT"),
        ((DEMO, "--tcp", "70000"), "expected [HOST:]PORT"),
        ((DEMO, "--units", "248"), "--units"),
    ],
)
def test_wrong_usage_is_reported_and_has_its_status(arguments, says):
    done = printed(*map(str, arguments))
    assert done.returncode == 2
    assert says in done.stderr


@pytest.mark.parametrize("option", ["--tcp", "--rtu-over-tcp"])
def test_it_reports_the_addresses_of_its_sockets_and_answers_there(tmp_path, option):
    request = build_request(VELOCITIES)
    raw = option == "--rtu-over-tcp"
    question = request if raw else struct.pack(">HHH", 1, 0, len(request) - 2) + request[:-2]
    with start_simulator(DEMO, link_dir=tmp_path, options=(option, "0")) as sim:
        host, _, port = sim.ports["rs485"].rpartition(":")
        with socket.create_connection((host, int(port)), ARRIVAL_DEADLINE_S) as connection:
            connection.sendall(question)
            assert connection.recv(1) == question[:1]


def test_a_tagged_robot_lists_its_answers_in_the_journal(tmp_path):
    with start_simulator(DEMO, link_dir=tmp_path, options=("--tagged", "--units", "3")) as sim:
        before_ns = time.monotonic_ns()
        for unit in (1, 3):
            asked = Request(unit, Function.READ_HOLDING, 0x20A7, 2)
            reply = ask(sim.ports["rs485"], asked)
            (entry,) = sim.control.journal("rs485", unit)
            assert tuple(entry["words"]) == reply.values == (unit << 8, 0)
            assert before_ns < entry["monotonic_ns"] < time.monotonic_ns()
        assert sim.control.journal("rs485", 2) == []
        with pytest.raises(ControlError, match="no unit 4"):
            sim.control.journal("rs485", 4)
        late_us = sim.control.stats()["lines"]["rs485"]["reply_lateness_us"]
        assert 0 <= late_us["p50"] <= late_us["p99"] <= late_us["max"]


@pytest.mark.parametrize("kind", ["modbus-tcp", "rtu-over-tcp"])
def test_a_line_behind_a_gateway_is_served_over_tcp_without_an_option(tmp_path, kind):
    robot = tmp_path / "robot.toml"
    text = DEMO.read_text().replace('"modbus-rtu"', f'"{kind}"')
    robot.write_text(text.replace('port = "/dev/ttyUSB0"', 'host = "192.0.2.1"'))
    with start_simulator(robot, link_dir=tmp_path / "sim") as sim:
        host, _, port = sim.ports["rs485"].rpartition(":")
        with socket.create_connection((host, int(port)), ARRIVAL_DEADLINE_S):
            assert host == "127.0.0.1"


def test_the_settings_that_it_prints_fit_the_robot_file(tmp_path):
    robot = tmp_path / "robot.toml"
    text = DEMO.read_text().replace('"modbus-rtu"', '"modbus-tcp"')
    robot.write_text(text.replace('port = "/dev/ttyUSB0"', 'host = "192.0.2.1"'))
    with simulate(str(robot)) as process:
        lines = [process.stdout.readline() for _ in range(3)]
        process.send_signal(signal.SIGTERM)
    settings = re.findall(r"--set (\S+)", lines[2])
    made = load_robot(robot, settings)
    assert f"line rs485: {made.line['rs485'].address}" in lines[1]


def may_be_fifo():
    """Return whether SCHED_FIFO is allowed. Another process tries it: this one stays as it is."""
    tried = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    done = subprocess.run([sys.executable, "-c", tried], capture_output=True, check=False)
    return done.returncode == 0


def test_a_priority_is_applied_or_its_refusal_is_reported():
    if not may_be_fifo():
        done = printed(str(DEMO), "--priority", "1")
        assert (done.returncode, done.stdout) == (2, "")
        assert "--priority 1: " in done.stderr
        return
    with start_simulator(DEMO, options=("--priority", "1")) as sim:
        assert os.sched_getscheduler(sim.process.pid) == os.SCHED_FIFO
        assert ask(sim.ports["rs485"], VELOCITIES).values == (0, 0)
