# SPDX-License-Identifier: Apache-2.0
"""The schemas of the robot file and of drive profiles: shipped up to date, and complete
for an editor."""

import json
import math
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
from jsonschema.exceptions import best_match

from motord.config import load_robot
from motord.config.schema import drive_schema, robot_schema

CONFIG = Path(__file__).resolve().parents[3] / "config"
UNITS = {
    "m": "m", "m_s": "m/s", "m_s2": "m/s²", "m_s3": "m/s³", "rad_s": "rad/s", "rad_s2": "rad/s²",
    "rad": "rad",
    "rad_s3": "rad/s³", "s": "s", "hz": "Hz", "per_s": "1/s", "m2_per_m": "m²/m", "m2": "m²",
    "rad2_per_rad": "rad²/rad",
    "rad2_per_s": "rad²/s", "rad2": "rad²", "m2_s2": "m²/s²", "rad2_s2": "rad²/s²",
    "mb": "MB", "v": "V", "ah": "Ah", "ohm": "Ω", "n_m": "N·m",
    "n_m_per_rad": "N·m/rad", "n_m_s_per_rad": "N·m·s/rad", "n_m_s2_per_rad": "N·m·s²/rad",
    "s_per_rad": "s/rad", "per_rad": "1/rad", "s2_per_rad": "s²/rad", "kg_m2": "kg·m²",
    "c": "°C", "a": "A",
}  # fmt: skip


SCHEMAS = {"robot": robot_schema, "drive": drive_schema}


def numbers():
    """Yield (name, schema) of every number of the robot file."""
    for section in robot_schema()["$defs"].values():
        for name, node in section["properties"].items():
            inner = next((part for part in node.get("anyOf", ()) if part.get("type") != "null"), {})
            if {**node, **inner}.get("type") in ("number", "integer"):
                yield name, {**node, **inner}


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_shipped_schema_is_that_of_the_program(name):
    shipped = (CONFIG / f"schema/{name}.schema.json").read_text(encoding="utf-8")
    assert json.loads(shipped) == json.loads(json.dumps(SCHEMAS[name]())), (
        f"make it again: .venv/bin/motord schema {name} > config/schema/{name}.schema.json"
    )


@pytest.mark.parametrize("path", sorted(CONFIG.glob("drives/*.toml")), ids=lambda path: path.stem)
def test_an_editor_finds_nothing_wrong_with_a_shipped_profile(path):
    validator = jsonschema.Draft202012Validator(drive_schema())
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    assert [error.message for error in validator.iter_errors(data)] == []


@pytest.mark.parametrize(
    ("right", "wrong", "found"),
    [
        ("bitrate = 500000", "bitrate = 5", "5 is less than the minimum of 10000"),
        ('dbc = "DRV_Power"\n', "", "is not valid under any of the given schemas"),
        ("[can]", "[serial]", "'can' is a required property"),
    ],
)
def test_an_editor_finds_a_mistake_in_a_profile(right, wrong, found):
    text = (CONFIG / "drives/dbc-example.toml").read_text(encoding="utf-8").replace(right, wrong, 1)
    validator = jsonschema.Draft202012Validator(drive_schema())
    errors = validator.iter_errors(tomllib.loads(text))
    messages = [best_match([error]).message for error in errors]
    assert any(found in message for message in messages), messages


def test_every_key_of_a_profile_has_a_description():
    schema = drive_schema()
    for table in (schema, *schema["$defs"].values()):
        for name, node in table["properties"].items():
            assert node.get("description") or "$ref" in str(node), name


def test_every_number_has_a_range_a_unit_and_a_description():
    for name, node in numbers():
        assert "minimum" in node, name
        assert "maximum" in node or "inf: no limit" in node["description"], name
        assert node["unit"], name
        assert node["description"], name


def test_every_unit_is_that_of_the_name():
    for name, node in numbers():
        found = [unit for ending, unit in UNITS.items() if name.endswith(f"_{ending}")]
        longest = max(found, key=len, default=None)
        if longest is None:
            assert node["unit"] in ("1", "1/s"), name
        else:
            assert node["unit"] in found, name


def test_every_default_lies_within_its_range():
    for name, node in numbers():
        default = node.get("default")
        if default is not None:
            assert node["minimum"] <= default <= node.get("maximum", math.inf), name


@pytest.mark.parametrize("schema", SCHEMAS.values())
def test_the_schema_is_json_without_infinities(schema):
    text = json.dumps(schema(), allow_nan=False)
    assert not re.search(r"Infinity|NaN", text)


@pytest.mark.parametrize("path", sorted(CONFIG.glob("robots/*.toml")), ids=lambda path: path.stem)
def test_every_shipped_robot_is_good_and_named_like_its_file(path):
    assert load_robot(path).robot.name == path.stem
