# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings for `motord replay` and `motord calibrate --from`: the command uses the file,
or ends with one line that has the file and the reason, and status 2, never with a traceback."""

import random
import shutil
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.unit.commission.test_log_fit import recorded
from tests.unit.commission.test_log_fit import recording as of_poses

from motord.cli import cli

ROOT = Path(__file__).resolve().parents[3]
sys.path.append(str(ROOT / "tests/fuzz"))
ROBOT = ROOT / "config/robots/demo.toml"
FEW, MANY = 60, 1000


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    import recording

    folder = tmp_path_factory.mktemp("recordings")
    shutil.copy(ROBOT, folder / "robot.toml")
    recording._journal(folder / "replay.mcap", "demo", random.Random(1))
    of_poses(folder / "calibrate.mcap", recorded(0, path_m=20.0))
    return folder


def command_of(name, path, folder):
    if name == "replay":
        return ["replay", str(path)]
    robot = ["--file", str(folder / "robot.toml"), "--pose-topic", "/ground_truth"]
    return ["calibrate", "--from", str(path), *robot, "--dry-run"]


def damaged(dice, data):
    """Change one byte, cut the file off, or repeat a part of it."""
    begin = dice.randrange(len(data))
    match dice.choice(("byte", "byte", "cut", "repeat")):
        case "byte":
            return data[:begin] + bytes((dice.randrange(256),)) + data[begin + 1 :]
        case "cut":
            return data[:begin]
        case _:
            end = min(len(data), begin + dice.choice((1, 8, 64, 1000)))
            return data[:end] + data[begin:]


@pytest.mark.parametrize("count", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", ["replay", "calibrate"])
def test_a_damaged_recording_is_used_or_refused_in_one_line(originals, name, count, tmp_path):
    seed = random.randrange(1 << 32)
    print(f"seed {seed}")
    dice, good = random.Random(seed), (originals / f"{name}.mcap").read_bytes()
    path, statuses = tmp_path / "damaged.mcap", []
    path.write_bytes(good)
    assert CliRunner().invoke(cli, command_of(name, path, originals)).exit_code != 2, "undamaged"
    for _ in range(count):
        path.write_bytes(damaged(dice, good))
        done = CliRunner().invoke(cli, command_of(name, path, originals))
        statuses.append(done.exit_code)
        assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
        assert done.exit_code in (0, 1, 2), done.output
        if done.exit_code == 2:
            (line,) = done.stderr.splitlines()
            assert line.startswith(f"Error: {path}"), line
        elif done.exit_code == 1:  # a result that differs is no damage that can be seen
            assert name == "replay", done.stderr
    print({status: statuses.count(status) for status in set(statuses)})
    assert 2 in statuses
