# SPDX-License-Identifier: Apache-2.0
"""Every process that motord starts takes its code from where motord is installed, never from the
folder in which the command was typed."""

import importlib.metadata
import json
import subprocess
import sys

import pytest
from tests.fork_server import started_from_nothing
from tests.sim.daemon_stage import DEADLINE_S, ROBOT, SURE

NAMES = (
    *sys.stdlib_module_names, *importlib.metadata.packages_distributions(),
    "motord", "motord_hal", "_motord_rt", "_motord_bus", "sitecustomize", "usercustomize",
)  # fmt: skip
"""Modules that a program may import, under the names that a file of the folder could have."""
DEAD_MAN = """
from pathlib import Path
from motord.commission.dead_man import dead_man
with dead_man(Path("missing.sock")):
    pass
"""
ANSWERED = """
import asyncio, sys
from motord.bus.web.processes.command import answer, asked
async def main():
    print(await answer("robots", within_s=60))
    request = {"do": "read", "file": sys.argv[1]}
    print(await asked("motord.commission.page.robot_file", request, within_s=60))
asyncio.run(main())
"""
LATENCY = ("latency", "--json", "--seconds", "1", "--load", "cpu")


@pytest.fixture(scope="module", params=["files", "checkout"])
def folder(request, tmp_path_factory):
    """A folder in which every file leaves a mark when it is executed, or the folder above a
    checkout that is named motord."""
    folder = tmp_path_factory.mktemp(request.param)
    mark = f"open({json.dumps(str(folder / 'mark'))}, 'a').write(__name__ + '\\n')\n"
    if request.param == "files":
        for name in NAMES:
            (folder / f"{name}.py").write_text(mark)
    for package in ("motord/config", "motord/base", "motord/bus", "motord/cli", "motord_hal/base"):
        if request.param == "checkout":
            (folder / package).mkdir(parents=True)
            (folder / package / "load.py").write_text(mark)
    return folder


def ran(folder, *words):
    """Run Python in the folder, without the folder on its own path, as the script `motord` is."""
    with started_from_nothing():
        done = subprocess.run(
            [sys.executable, "-P", *map(str, words)],
            cwd=folder, capture_output=True, text=True, timeout=DEADLINE_S,
        )  # fmt: skip
    executed = (folder / "mark").read_text().split() if (folder / "mark").exists() else []
    assert executed == []
    assert "Traceback" not in done.stderr, done.stderr
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def recording(folder):
    """A recording of a demonstration: a simulator, a daemon, its reader and motord-bus."""
    tape = {
        "kind": "mcap", "folder": str(folder / "tape"), "journal": True, "rate_hz": 10,
        "free_min_mb": 0,
    }  # fmt: skip
    settings = [f"--set={setting}" for setting in SURE]
    settings += [f"--set=publish.tape.{key}={json.dumps(value)}" for key, value in tape.items()]
    ran(folder, "-m", "motord", "demo", "--json", "--seconds", "5", *settings)
    (path,) = (folder / "tape").glob("*.mcap")
    return path


def test_a_demonstration_runs_no_code_of_the_folder(recording):
    assert recording.stat().st_size > 0


def test_a_replay_with_buses_runs_no_code_of_the_folder(folder, recording):
    name = f"robot.name=r{recording.stat().st_ino}"
    words = ("--publish", ROBOT, "--set", name, "--set", "publish.table.kind=stdout", recording)
    assert "bit-identical" in ran(folder, "-m", "motord", "replay", *words)


def test_the_daemon_that_the_doctor_starts_runs_no_code_of_the_folder(folder):
    with started_from_nothing():
        done = subprocess.run(
            [sys.executable, "-P", "-m", "motord", "doctor", str(ROBOT), "--json"],
            cwd=folder, capture_output=True, text=True, timeout=DEADLINE_S,
        )  # fmt: skip
    assert "Traceback" not in done.stderr, done.stderr
    assert not (folder / "mark").exists()
    assert json.loads(done.stdout)["findings"]


@pytest.mark.parametrize("program", [DEAD_MAN, ANSWERED], ids=["dead man", "page"])
def test_a_helper_of_a_program_runs_no_code_of_the_folder(folder, program):
    ran(folder, "-c", program, ROBOT)


def test_the_other_end_of_a_measurement_runs_no_code_of_the_folder(folder):
    assert json.loads(ran(folder, "-m", "motord", *LATENCY))["ticks"] > 0
