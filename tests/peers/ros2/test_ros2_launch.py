# SPDX-License-Identifier: Apache-2.0
"""The launch file, read by launch where ROS 2 is, and by a stand-in of its words elsewhere."""

import importlib.util
import sys
from types import ModuleType

import pytest
from tests.sim.daemon_stage import ROOT

FILE = ROOT / "daemon/ros2/launch/bridge.launch.py"
REAL = importlib.util.find_spec("launch_ros") is not None
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
    if not REAL:
        for name, words in WORDS.items():
            module = ModuleType(name)
            for word in words:
                setattr(module, word, type(word, (Word,), {}))
            monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("bridge_launch", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


@pytest.mark.skipif(not REAL, reason="needs launch_ros")
def test_launch_knows_its_arguments(description):
    names = [argument.name for argument in description.get_launch_arguments()]
    assert {"namespace", "params_file", "cmd_vel", "robot"} <= set(names)


@pytest.mark.skipif(REAL, reason="launch_ros is here")
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
