# SPDX-License-Identifier: Apache-2.0
"""The README's programs work literally, in the environment that its two commands make."""

import re
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import DEADLINE_S, ROOT, TRIES, running, was_held_up

README = (ROOT / "README.md").read_text(encoding="utf-8")
EXTRA_OF = {"motord top": "tui", "--plot": "plot"}
"""Extra that each part needs: packages which `pip install motord` leaves out."""


@pytest.fixture
def stage(tmp_path):
    with running(tmp_path, "safety.feedback_timeout_s=2.0") as stage:
        stage.wait_for("idle")
        yield stage


def test_the_python_program_of_the_readme_drives_a_robot(stage):
    (code,) = re.findall(r"^```python\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
    assert code.count("Client()") == 1
    code = code.replace("Client()", f"Client({str(stage.socket)!r})")
    for _ in range(TRIES):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            cwd=stage.socket.parent,
        )
        if not was_held_up(done.stderr):
            break
    assert done.returncode == 0, done.stderr
    distances_m = [float(line) for line in done.stdout.splitlines()]
    assert len(distances_m) > 5
    assert stage.state() == "idle"
    odometry = stage.robot.status().odometry
    assert abs(odometry.y_m) > 0.3  # half a metre ahead, a quarter to the left, and on


@pytest.mark.parametrize("shown", EXTRA_OF)
def test_make_demo_installs_the_packages_of_the_readmes_program(shown):
    assert shown in README
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    made = makefile[makefile.index("$(VENV)/made:") : makefile.index("$(VENV)/built:")]
    assert EXTRA_OF[shown] in re.search(r"\.\[(.*)\]", made)[1].split(",")
