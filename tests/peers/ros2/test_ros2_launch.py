# SPDX-License-Identifier: Apache-2.0
"""The launch file. launch and launch_ros run it where they are installed, a stand-in of them
elsewhere."""

import importlib.util
import itertools
import json
import os
import signal
import subprocess
import sys
from types import ModuleType

import pytest
from tests.peers.ros2_rclpy.rclpy_real import ENVIRON, PYTHON
from tests.sim.daemon_stage import DEADLINE_S, ROOT, wait_until

FILE = ROOT / "daemon/ros2/launch/bridge.launch.py"
WORDS = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument",),
    "launch.substitutions": ("LaunchConfiguration", "PathJoinSubstitution"),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
    "launch_ros.substitutions": ("FindPackageShare",),
}


class Word:
    def __init__(self, *positional, **named):
        self.positional, self.named = positional, named


@pytest.fixture
def description(monkeypatch):
    for name, words in WORDS.items():
        module = ModuleType(name)
        for word in words:
            setattr(module, word, type(word, (Word,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("bridge_launch", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


def test_every_argument_that_is_used_is_declared_and_has_a_default(description):
    *declared, node = description.positional[0]
    assert type(node).__name__ == "Node"
    names = {argument.positional[0] for argument in declared}
    assert all("default_value" in argument.named for argument in declared)

    def used(value):
        if type(value).__name__ == "LaunchConfiguration":
            yield value.positional[0]
        elif isinstance(value, Word):
            yield from used([*value.positional, *value.named.values()])
        elif isinstance(value, dict):
            yield from used(list(value.values()))
        elif isinstance(value, list | tuple):
            for item in value:
                yield from used(item)

    assert set(used(node)) == names
    assert (node.named["package"], node.named["executable"]) == ("motord_ros2", "bridge")
    assert (ROOT / "daemon/ros2/scripts/bridge").is_file()
    assert [topic for topic, _ in node.named["remappings"]] == ["cmd_vel", "joint_commands"]


LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

file, *given = sys.argv[1:]
included = IncludeLaunchDescription(
    PythonLaunchDescriptionSource(file),
    launch_arguments=[tuple(one.split(":=", 1)) for one in given],
)
service = LaunchService(noninteractive=True)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""
BRIDGE = """#!{python}
import json, os, signal, sys
from pathlib import Path
words = sys.argv[1:]
options = zip(words, words[1:])
files = [Path(after).read_text() for word, after in options if word == "--params-file"]
found = Path(os.environ["FOUND"])
found.with_suffix(".new").write_text(json.dumps([words, files]))
found.with_suffix(".new").rename(found)
signal.pause()
"""


@pytest.fixture
def launched(tmp_path):
    """Return a function that launches the file with arguments. It returns the bridge's command line
    and the texts of its parameter files."""
    environ = {**os.environ, **ENVIRON, "ROS_LOG_DIR": str(tmp_path / "log"),
               "AMENT_PREFIX_PATH": str(tmp_path), "FOUND": str(tmp_path / "found")}  # fmt: skip
    imported = subprocess.run(
        [PYTHON, "-c", "import launch_ros.actions"],
        env=environ, capture_output=True, timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    if imported.returncode != 0:
        pytest.skip("needs launch_ros, of which there is no wheel")
    program = tmp_path / "lib/motord_ros2/bridge"
    for place in ("lib/motord_ros2", "share/motord_ros2/config",
                  "share/ament_index/resource_index/packages"):  # fmt: skip
        (tmp_path / place).mkdir(parents=True)
    program.write_text(BRIDGE.format(python=sys.executable))
    program.chmod(0o755)
    (tmp_path / "share/ament_index/resource_index/packages/motord_ros2").touch()
    shipped = (ROOT / "daemon/ros2/config/bridge.yaml").read_text()
    (tmp_path / "share/motord_ros2/config/bridge.yaml").write_text(shipped)
    started = []

    def launch(*arguments):
        process = subprocess.Popen(
            [PYTHON, "-c", LAUNCH, FILE, *arguments], env=environ, cwd=tmp_path
        )
        started.append(process)
        found = tmp_path / "found"
        wait_until(found.exists, "the bridge")
        words, files = json.loads(found.read_text())
        assert files[-1] == shipped
        return words, files

    yield launch
    for process in started:
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0


def pairs(words, option):
    return [after for word, after in itertools.pairwise(words) if word == option]


def test_launch_starts_the_bridge_with_its_namespace_remaps_and_parameters(launched):
    words, files = launched("namespace:=/r2", "robot:=7", "cmd_vel:=/cmd_vel_safe")
    remaps = ["__node:=motord", "__ns:=/r2", "cmd_vel:=/cmd_vel_safe",
              "joint_commands:=joint_commands"]  # fmt: skip
    assert pairs(words, "-r") == remaps
    assert "robot: '7'" in files[0], "a robot's name that is a number stays a text"


def test_launch_needs_no_arguments(launched):
    words, files = launched()
    assert pairs(words, "-r")[:2] == ["__node:=motord", "__ns:=/"]
    assert "robot: ''" in files[0]
