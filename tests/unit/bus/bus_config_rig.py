# SPDX-License-Identifier: Apache-2.0
"""Robot files with a bus, and the errors that they give."""

from pathlib import Path

import pytest

from motord.config import ConfigError, load_robot

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


def robot_file(tmp_path, text):
    path = tmp_path / "robot.toml"
    path.write_text(DEMO.read_text(encoding="utf-8") + "\n" + text, encoding="utf-8")
    return path


def errors(tmp_path, text):
    with pytest.raises(ConfigError) as caught:
        load_robot(robot_file(tmp_path, text))
    return [f"{row.key}: {row.text}" for row in caught.value.problems]
