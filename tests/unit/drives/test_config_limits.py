# SPDX-License-Identifier: Apache-2.0
"""A robot file or drive profile that is too long, too deep or odd gives short lines of errors."""

import tomllib

import pytest

from motord.config import ConfigError, load_robot
from motord.config.drives.load import load_profile
from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir

BOMBS = {
    "arrays": "a = " + "[" * 50_000,
    "closed arrays": "a = " + "[" * 300 + "]" * 300,
    "tables": "a = " + "{b = " * 5_000,
    "key": ".".join("a" * 50_000) + " = 1",
    "quoted key": ".".join(['"a"'] * 20_000) + " = 1",
    "header": "[" + ".".join("a" * 50_000) + "]",
    "integer": "[base]\ntrack_m = " + "1" * 5_000,
    "hexadecimal": "[base]\ntrack_m = 0x" + "f" * 100_000,
    "long integer": "[base]\ntrack_m = " + "1" * 4_000,
    "float": "[base]\ntrack_m = " + "1" * 5_000 + ".5",
    "string": "robot.name = '" + "x" * 50_000_000 + "'",
    "quotes": '"' * 200_000,
    "backslashes": 'a = "' + "\\" * 200_001,
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_an_excessive_file_is_refused_in_short_lines(tmp_path, bomb):
    file = tmp_path / "robot.toml"
    file.write_text(BOMBS[bomb], encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_robot(file)
    rows = str(refused.value).splitlines()
    assert all(row.startswith(f"{file}") for row in rows)
    assert max(map(len, rows)) < 1000
    with pytest.raises(ProfileError) as unusable:
        load_profile(file)
    assert all(len(row) < 1000 for row in str(unusable.value).splitlines())


def test_a_file_without_end_is_refused(tmp_path):
    file = tmp_path / "robot.toml"
    with file.open("wb") as sparse:
        sparse.truncate(1 << 40)
    with pytest.raises(ConfigError, match="cannot be read: has more than"):
        load_robot(file)


def test_a_name_with_a_zero_byte_is_no_file(tmp_path):
    file = tmp_path / "robot.toml"
    demo = (config_dir() / "robots/demo.toml").read_text(encoding="utf-8")
    file.write_text(demo.replace('"zlac8015d"', '"a\\u0000.toml"'), encoding="utf-8")
    with pytest.raises(ConfigError, match="cannot be read: Invalid argument"):
        load_robot(file)


@pytest.mark.parametrize("bomb", [text for text in BOMBS.values() if len(text) < 100_000])
def test_an_option_is_bounded_as_the_file_is(tmp_path, bomb):
    file = tmp_path / "robot.toml"
    file.write_text("", encoding="utf-8")
    for option in (bomb, f"robot.name={bomb}", f"{bomb}=1"):
        with pytest.raises(ConfigError):
            load_robot(file, [option])


def test_the_line_that_goes_too_deep_is_named():
    deep = "[" * (bounded.DEPTH_MAX + 1)
    with pytest.raises(tomllib.TOMLDecodeError, match="at line 4, column 1"):
        bounded.toml(f"a = '''\n[[[[[[\n'''\nb = {deep}")
    long = ".".join("a" * (bounded.DEPTH_MAX + 1))
    with pytest.raises(tomllib.TOMLDecodeError, match="at line 2, column 1"):
        bounded.toml(f"# {long}\n{long} = 1")


def test_nesting_up_to_the_limit_is_read():
    deep = "[" * bounded.DEPTH_MAX + "]" * bounded.DEPTH_MAX
    key = ".".join("a" * bounded.DEPTH_MAX)
    found = bounded.toml(f'a1 = {deep}\ntext = "{"." * 99}{"[" * 99}" # {"[" * 99}\n{key} = 1.5\n')
    assert set(found) == {"a1", "text", "a"}
