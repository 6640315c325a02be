# SPDX-License-Identifier: Apache-2.0
"""Shipped robot files with one to three changes: loading finds what is wrong with each, or accepts
it; no rule fails. `CHANGED_FILES` sets how many files are tried, `CHANGED_SEED` repeats a run."""

import copy
import os
import random
import tomllib
from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot
from motord.config.rules import checks

ROBOTS = sorted((Path(__file__).resolve().parents[3] / "config/robots").glob("*.toml"))
FILES = int(os.environ.get("CHANGED_FILES", "80"))
SPOILED = [0, 1, 2, 9, -1, 0.0, 1e-9, 1e308, float("nan"), True, "", "x", "left", "/dev/null", [],
           ["left"], {}, {"x": 1}]  # fmt: skip
"""Values of any type that replace one of the file."""


def tables(inside, path=()):
    """Yield the paths of all tables and of all other keys."""
    for key, value in inside.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from tables(value, (*path, key))


def changed(data, draw):
    """Change one place of the data: remove it, replace it, or copy another one to it."""
    places = list(tables(data))
    path = draw.choice(places)
    around = data
    for key in path[:-1]:
        around = around[key]
    how = draw.choice(("remove", "spoil", "copy", "rename"))
    if how == "remove":
        del around[path[-1]]
    elif how == "spoil":
        around[path[-1]] = copy.deepcopy(draw.choice(SPOILED))
    elif how == "rename":
        around[path[-1] + "x"] = around.pop(path[-1])
    else:
        other = data
        for key in draw.choice(places):
            other = other[key]
        around[path[-1]] = copy.deepcopy(other)  # it may contain this place
    return path, how


def toml(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(one)}" for key, one in value.items()) + "}"
    return repr(value)


@pytest.fixture(scope="module")
def seed():
    found = int(os.environ.get("CHANGED_SEED", random.SystemRandom().getrandbits(32)))
    print(f"CHANGED_SEED={found}")
    return found


@pytest.mark.parametrize("part", range(4))
def test_a_changed_file_is_accepted_or_refused_with_findings(tmp_path, seed, part):
    print(f"CHANGED_SEED={seed}")
    draw = random.Random(seed + part)
    file = tmp_path / "robot.toml"
    for _ in range(FILES // 4):
        source = draw.choice(ROBOTS)
        data = tomllib.loads(source.read_text(encoding="utf-8"))
        changes = [changed(data, draw) for _ in range(draw.randint(1, 3)) if data]
        text = "".join(f"{toml(key)} = {toml(value)}\n" for key, value in data.items())
        file.write_text(text, encoding="utf-8")
        print(source.name, changes)
        try:
            load_robot(file)
        except ConfigError as error:
            assert "a check of motord failed" not in str(error)  # noqa: PT017  or it is accepted


@pytest.mark.parametrize("error", [KeyError(2), ZeroDivisionError("x"), TypeError("y")])
def test_a_rule_that_fails_is_a_finding_that_refuses_the_file(tmp_path, monkeypatch, error):
    def fails(_robot):
        raise error
        yield

    monkeypatch.setattr(checks, "ROBOT_RULES", (*checks.ROBOT_RULES, fails))
    with pytest.raises(ConfigError) as caught:
        load_robot(ROBOTS[0])
    (row,) = caught.value.problems
    assert row.line > 0
    assert f"a check of motord failed ({__name__}.fails: {type(error).__name__}" in row.text
