# SPDX-License-Identifier: Apache-2.0
"""A child process reads the robot file, with the same result as pydantic in this process."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from motord.config import load_robot
from motord.config.robot_file import handed_over

ROOT = Path(__file__).resolve().parents[3]
ROBOTS = sorted(ROOT.glob("config/robots/*.toml"))
DEADLINE_S = 120.0
SEEN = """
import json, sys
from pathlib import Path
from motord.base import validation

def seen(value):
    if type(value).__module__.startswith("motord.config") and hasattr(value, "model_fields_set"):
        names = {name for name in vars(value) if not name.startswith("_")} | {
            name for kind in type(value).__mro__ for name, found in vars(kind).items()
            if kind.__module__.startswith("motord.config.") and isinstance(found, property)
        } - {"local_input"}
        found = {name: seen(getattr(value, name)) for name in sorted(names)}
        return found | {"": type(value).__name__, "given": sorted(value.model_fields_set)}
    if isinstance(value, dict):
        return {key: seen(one) for key, one in value.items()}
    if isinstance(value, tuple | list):
        return [seen(one) for one in value]
    return value if value is None or isinstance(value, bool | int | float | str) else repr(value)
"""


def program(lines, *arguments, **more):
    ran = subprocess.run(
        [sys.executable, "-c", SEEN + lines, *arguments],
        capture_output=True, timeout=DEADLINE_S, check=False, **more,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr.decode()
    return ran.stdout


def test_a_process_without_pydantic_holds_what_pydantic_found():
    raw = json.dumps([handed_over(load_robot(path)).decode() for path in ROBOTS]).encode()
    lines = """
if sys.argv[1] == "plain":
    validation.HERE = False
from motord.config.robot_file import handed_over, taken_over
robots = [taken_over(one.encode()) for one in json.load(sys.stdin)]
assert ("pydantic" in sys.modules) == (sys.argv[1] != "plain")
if sys.argv[1] == "plain":  # and what such a process hands over is the same again
    robots = [taken_over(handed_over(one)) for one in robots]
inputs = [(one.local_input.enabled, one.commanders()) for one in robots]
print(json.dumps([inputs, [seen(robot) for robot in robots]]))
"""
    plain, checked = (program(lines, how, input=raw) for how in ("plain", "checked"))
    assert len(json.loads(plain)[1]) == len(ROBOTS) > 10
    assert json.loads(plain) == json.loads(checked)


ASKED = """
if sys.argv[1] == "child":
    validation.elsewhere()
from motord.config import ConfigError, load_robot
try:
    print(json.dumps(seen(load_robot(sys.argv[2], sys.argv[3:]))))
except ConfigError as error:
    print(json.dumps(str(error)))
assert ("pydantic" in sys.modules) == (sys.argv[1] == "here")
"""


@pytest.mark.parametrize("override", ["limits.linear_m_s=0.25", "limits.linear_m_s=fast"])
def test_a_child_answers_as_this_process_would(override):
    arguments = (str(ROOT / "config/robots/demo.toml"), override)
    assert json.loads(program(ASKED, "child", *arguments)) == json.loads(
        program(ASKED, "here", *arguments)
    )


def test_a_child_that_fails_is_reported_and_gives_no_robot():
    lines = """
sys.executable = "/bin/false"
validation.elsewhere()
try:
    validation.ask("robot.toml", (), None)
except RuntimeError as error:
    print(error)
"""
    assert b"has failed" in program(lines)


def test_a_process_that_never_validates_leaves_no_child_behind():
    lines = """
validation.elsewhere()
validation._reader.stdin.close()
print(validation._reader.wait())
"""
    assert program(lines).strip() == b"0"


def test_the_ranges_of_numbers_are_the_same_without_pydantic():
    lines = """
validation.HERE = sys.argv[1] == "here"
from motord.config import Limits
from motord.config.sections.section import numbers_of
print(json.dumps({name: repr(one) for name, one in numbers_of(Limits).items()}))
"""
    assert program(lines, "here") == program(lines, "plain")


def test_a_value_cannot_be_changed_afterwards():
    robot = load_robot(ROBOTS[0])
    with pytest.raises(ValueError, match="frozen"):
        robot.limits.linear_m_s = 9.0
    lines = """
validation.HERE = False
from motord.config import Limits
limits = Limits(linear_m_s=0.5)
try:
    limits.linear_m_s = 9.0
except AttributeError:
    print(limits.linear_m_s)
"""
    assert program(lines).strip() == b"0.5"
