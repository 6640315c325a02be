# SPDX-License-Identifier: Apache-2.0
"""The drive of a robot with a whole daemon, recorded and run through the core again."""

import json
import signal
import subprocess
import sys
import uuid

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, ROOT, running, set_off, wait_until
from tests.sim.tools.journal_copy import flipped, rewritten

from motord.api.page_file import own_page


def settings(folder):
    return (
        "publish.tape.kind=mcap",
        f"publish.tape.folder={json.dumps(str(folder))}",
        "publish.tape.journal=true",
        "publish.tape.rate_hz=20",
        "publish.tape.free_min_mb=0",
    )


def command(*words, status=0):
    done = subprocess.run(
        [sys.executable, "-m", "motord", "replay", *map(str, words)],
        capture_output=True, text=True, timeout=120, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == status, done.stderr + done.stdout
    return done


def outcome(*words, status=0):
    return json.loads(command("--json", *words, status=status).stdout)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Recording of a robot that drove, turned, lost its command, and had an emergency stop."""
    folder = tmp_path_factory.mktemp("tape")
    with running(folder, "loop.rate_hz=1000", *settings(folder / "files")) as stage:
        stage.wait_for("idle")
        wait_until(lambda: list((folder / "files").glob("*.mcap")), "a recording")
        set_off(stage)
        stage.robot.drive(0.2, 0.8)
        wait_until(lambda: stage.state() == "armed", "the command has lapsed, and it rests")
        set_off(stage)
        stage.robot.estop()
        wait_until(lambda: stage.sim.truth().at_rest, "rest")
        assert stage.end() == 0
    (path,) = (folder / "files").glob("*.mcap")
    return path


def odometry(path):
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (one.pose.pose.position.x, one.pose.pose.position.y)
            for *_, one in reader.iter_decoded_messages(topics=["/odom"])
        ]


def test_a_recorded_drive_is_bit_identical_when_it_is_run_again(recording):
    found = outcome(recording)
    assert found["identical"]
    assert (found["gaps"], found["skipped"], found["differing_ticks"]) == (0, 0, 0)
    assert found["ticks"] > 1000
    assert found["checkpoints"] >= 1
    assert "bit-identical" in command(recording).stdout


def test_one_flipped_bit_of_the_input_is_found(recording, tmp_path):
    other = rewritten(recording, tmp_path / "other.mcap", flipped)
    found = outcome(other, status=1)
    assert not found["identical"]
    assert found["differing_ticks"] >= 1
    assert found["first_difference"].startswith("tick ")
    assert 1 <= len(found["differences"]) <= found["differing_ticks"]
    first = found["differences"][0]
    assert found["first_difference"] == (
        f"tick {first['tick']}: {', '.join(row['field'] for row in first['fields'])}"
    )
    assert first["time_s"] > 0.0


def test_missing_records_are_a_gap_and_the_rest_is_compared(recording, tmp_path):
    holes = rewritten(recording, tmp_path / "h.mcap", lambda n, data: None if n == 3 else data)
    found = outcome(holes)
    assert found["identical"]
    assert found["gaps"] == 1
    assert 0 < found["skipped"] <= 1024


def test_a_damaged_message_is_reported(recording, tmp_path):
    short = rewritten(recording, tmp_path / "s.mcap", lambda n, d: d[:-9] if n == 2 else d)
    assert "damaged" in command(short, status=2).stderr


def test_a_file_that_is_no_recording_or_has_no_journal_is_reported(recording, tmp_path):
    (tmp_path / "no.mcap").write_bytes(b"nothing of that kind" * 9)
    assert "not a complete MCAP file" in command(tmp_path / "no.mcap", status=2).stderr
    empty = rewritten(recording, tmp_path / "e.mcap", lambda *_: None)
    assert "journal = true" in command(empty, status=2).stderr


def test_a_replay_is_played_to_the_buses_of_a_robot_file(recording, tmp_path):
    again = tmp_path / "again"
    name = f"robot.name={tmp_path.name.replace('_', '-')}"
    overrides = [part for one in (name, *settings(again)) for part in ("--set", one)]
    assert outcome(recording, "--publish", ROBOT, *overrides)["identical"]
    assert not own_page(tmp_path.name.replace("_", "-")).exists()
    (path,) = again.glob("*.mcap")
    was, now = odometry(recording), odometry(path)
    assert now[-1] == pytest.approx(was[-1], abs=0.005)
    assert len(now) > len(was) / 2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_replay_that_is_ended_early_leaves_no_state_page(recording, number):
    name = f"t{uuid.uuid4().hex[:12]}"
    page = own_page(name)
    words = ["replay", str(recording), "--publish", str(ROBOT), "--set", f"robot.name={name}"]
    with subprocess.Popen([sys.executable, "-m", "motord", *words], cwd=ROOT) as process:
        try:
            wait_until(lambda: page.exists() and page.stat().st_size > 0, "the state page")
            process.send_signal(number)
            assert process.wait(DEADLINE_S) == 128 + number
            assert not page.exists()
        finally:
            process.kill()
            page.unlink(missing_ok=True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_a_state_page_is_created_leaves_none(tmp_path, number):
    name = f"t{uuid.uuid4().hex[:12]}"
    page = own_page(name)
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background\n"
        "from motord.__main__ import main\n"
        "really = os.truncate\n"
        "def truncate(*args):\n"
        "    really(*args)\n"
        f"    signal.raise_signal({int(number)})\n"
        "os.truncate = truncate\n"
        "main()\n"
    )
    (tmp_path / "any.mcap").touch()
    words = ["replay", str(tmp_path / "any.mcap"), "--publish", str(ROBOT)]
    command = [sys.executable, "-c", code, *words, "--set", f"robot.name={name}"]
    try:
        ended = subprocess.run(command, timeout=DEADLINE_S, cwd=ROOT, stderr=subprocess.PIPE)
        assert ended.returncode == 128 + number, ended.stderr
        assert not page.exists()
    finally:
        page.unlink(missing_ok=True)


def test_a_replay_over_a_running_robot_is_refused(recording, tmp_path):
    with running(tmp_path) as stage:
        wait_until(lambda: stage.robot.status()["at_rest"], "rest is seen")
        name = stage.robot.status()["robot"]
        result = command(recording, "--publish", ROBOT, "--set", f"robot.name={name}", status=1)
        assert "living daemon" in result.stderr
        assert stage.end() == 0
