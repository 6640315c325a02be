# SPDX-License-Identifier: Apache-2.0
"""`motord trace` on daemons with simulated drives: a serial line in C, one in asyncio, a CAN
bus."""

import json
import re
import shutil
import subprocess
import sys

import can
import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running
from tests.sim.pseudo_terminal import at_terminal

from motord.client import ClientError


@pytest.fixture(scope="module", params=["rt", "asyncio"])
def stage(tmp_path_factory, request):
    engine = f"line.rs485.engine={request.param}"
    with running(tmp_path_factory.mktemp("trace"), engine) as stage:
        stage.wait_for("idle")
        yield stage


def trace(stage, *words):
    done = subprocess.run(
        [sys.executable, "-m", "motord", "trace", "--socket", str(stage.socket), *words],
        capture_output=True, text=True, cwd=ROOT, timeout=DEADLINE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_exchanges_are_decoded_with_time_bytes_and_result(stage):
    rows = [json.loads(row) for row in trace(stage, "--json", "--count", "12").splitlines()]
    good = [row for row in rows if row["result"] == "ok"]
    assert good
    assert {row["joint"] for row in good} <= {"left,right", "left", "right"}
    assert any("velocity" in row["what"] or "position" in row["what"] for row in good)
    assert all(row["reply_us"] > 0 and row["sent"] and row["received"] for row in good)


def test_at_a_terminal_it_runs_until_ctrl_c(stage):
    with at_terminal("trace", "rs485", "--socket", str(stage.socket)) as terminal:
        terminal.wait_for(" ok ")
        terminal.type("\x03")
        assert terminal.exit_status() == 0


@pytest.mark.parametrize(
    ("fault", "result"),
    [("corrupt:unit=1,p=0.3", "bad"), ("exception:unit=1,code=4,p=0.3", "exception 4")],
)
def test_a_reply_with_a_wrong_check_sum_and_an_exception_are_named(stage, fault, result):
    stage.sim.inject(fault)
    try:
        found = ""
        while result not in found:  # pytest's time limit ends it
            rows = trace(stage, "--json", "--count", "10").splitlines()
            found = " ".join(json.loads(row)["result"] for row in rows)
    finally:
        stage.sim.clear_faults_script()


def test_wireshark_decodes_the_pcap(stage, tmp_path):
    if shutil.which("tshark") is None:
        pytest.skip("needs tshark")
    file = tmp_path / "rs485.pcap"
    trace(stage, "--count", "20", "--pcap", str(file))
    done = subprocess.run(
        ["tshark", "-r", str(file), "-T", "fields", "-e", "_ws.col.Protocol", "-e", "_ws.col.Info",
         "-e", "_ws.expert.message"],
        capture_output=True, text=True, timeout=DEADLINE_S,
    )  # fmt: skip
    rows = done.stdout.splitlines()
    assert len(rows) >= 20, done.stderr
    torn = ("alformed", "ncorrect", "nreassembled")  # a busy machine may tear a reply
    good = [row for row in rows if not any(word in row for word in torn)]
    assert all("Modbus" in row for row in good), rows
    assert any("Query" in row for row in good)
    assert any("Response" in row for row in good)


def test_an_unknown_line_is_named_with_a_suggestion(stage):
    with pytest.raises(ClientError, match='did you mean "rs485"'):
        stage.robot.call("trace", line="rs458")


CAN = ROOT / "config/robots/asyncio-can.toml"


def test_a_can_trace_is_a_file_that_can_utils_read(tmp_path):
    with running(tmp_path, robot=CAN) as stage:
        stage.wait_for("idle", "configuring")
        file = tmp_path / "bus.log"
        line = next(iter(stage.robot.status()["lines"]))
        rows = [
            json.loads(row)
            for row in trace(stage, line, "--json", "--count", "30", "--candump", str(file))
            .splitlines()
        ]  # fmt: skip
    with can.CanutilsLogReader(file) as reader:
        messages = list(reader)
    assert len(messages) == len(rows) == 30
    assert any(row["joint"] and row["what"] for row in rows)
    assert {row["result"] for row in rows} <= {"in", "out"}


BOARDS = {
    "esp32": ("set-points", "feedback", r"velocity_setpoint|target|control"),
    "arduino-text": ("set-points:", "feedback:", r"left|right"),
    "roboclaw": ("read command 78", "→", r"encoder|position"),
    "two-bus-servos": ("read ", "→ left:", r"position|velocity"),
    "turtlebot3-burger": ("read ", "→ ", r"position|velocity"),
    "hoverboard-rover": ("set-points: target_", "feedback: ", "velocity_left .*voltage 3"),
    "sabertooth": ("write serial_timeout ", "motor_1 ", "motor_2 "),
}
"""Robot → texts for what is sent, what is received, and names of the profile."""


@pytest.mark.parametrize("name", BOARDS)
def test_boards_and_servos_are_decoded_by_their_profile(tmp_path, name):
    sent, came, names = BOARDS[name]
    with running(tmp_path, robot=ROOT / f"config/robots/{name}.toml") as stage:
        stage.wait_for("idle")
        rows = [json.loads(row) for row in trace(stage, "--json", "--count", "40").splitlines()]
    shown = [row["what"] for row in rows]
    assert any(sent in what for what in shown), shown
    assert any(came in what for what in shown), shown
    assert any(re.search(names, what) for what in shown), shown
    assert ("out" if name == "sabertooth" else "ok") in {row["result"] for row in rows}
    assert {joint for row in rows for joint in row["joint"].split(",")} & {"left", "right"}
