# SPDX-License-Identifier: Apache-2.0
"""The Python programs of the pages work literally: all of a page in the order in which a person
reads them, in one interpreter and on one robot, within a time limit."""

import math
import re
import subprocess
import sys

import pytest
from tests.sim.daemon_stage import (
    DEADLINE_S,
    ROOT,
    SURE,
    TRIES,
    becomes_idle,
    rests,
    running,
    was_held_up,
)

BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PAGES = {
    path.name: blocks
    for path in sorted((ROOT / "docs").rglob("*.md"))
    if (blocks := BLOCK.findall(path.read_text(encoding="utf-8")))
}
NOT_YET = "no fresh feedback"
"""Why arming is refused while a busy machine holds the drives up."""
JOINTS = tuple(
    f"joint.{name}.{setting}"
    for name in ("pan", "tilt")
    for setting in ("tries=10", "reply_timeout_s=0.2")
)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with running(tmp_path_factory.mktemp("base"), *SURE) as stage:
        stage.wait_for("idle")
        yield stage


@pytest.fixture(scope="module")
def head(tmp_path_factory):
    """A robot without a base, for the programs that command joints."""
    robot = ROOT / "config/robots/pan-tilt.toml"
    with running(tmp_path_factory.mktemp("head"), *JOINTS, robot=robot) as stage:
        stage.wait_for("idle")
        yield stage


def program(page, stage, head):
    """Return the page's blocks as one program, each with a client of the robot that it is for."""
    blocks = []
    for block in PAGES[page]:
        robot = head if ".joints(" in block else stage
        blocks.append(block.replace("Client()", f"Client({str(robot.socket)!r})"))
    return "\n".join(blocks)


def ran(page, stage, head):
    """Run the page's programs; return the path that the base drove meanwhile, and the distance from
    its beginning to its end. A try is repeated only where motord refused it for feedback or for a
    state that was too old."""
    for _ in range(TRIES):
        becomes_idle(stage)
        becomes_idle(head)
        before = stage.sim.truth()
        done = subprocess.run(
            [sys.executable, "-c", program(page, stage, head)],
            capture_output=True, text=True, timeout=DEADLINE_S, cwd=stage.socket.parent,
        )  # fmt: skip
        if not (was_held_up(done.stderr + done.stdout) or NOT_YET in done.stderr):
            break
    assert done.returncode == 0, done.stderr
    rests(stage)
    rests(head)
    after = stage.sim.truth()
    off_m = math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    return after.distance_m - before.distance_m, off_m


@pytest.mark.parametrize("page", PAGES)
def test_the_programs_of_a_page_run_in_their_order_and_end_at_rest(page, stage, head):
    driven_m, off_m = ran(page, stage, head)
    assert (stage.state(), head.state()) == ("idle", "idle")
    if page == "python.md":  # a metre, a turn to the right, two metres, and a metre
        assert driven_m == pytest.approx(4.0, abs=0.4)
        assert off_m == pytest.approx(math.hypot(1.0, 3.0), abs=0.4)
        joints = head.sim.truth().joints
        assert joints["pan"].position_rad == pytest.approx(0.5, abs=0.1)
        assert joints["tilt"].position_rad == pytest.approx(-0.2, abs=0.1)
