# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 package of our own types, as another parser reads its files."""

import re
from xml.etree.ElementTree import fromstring

import pytest
from click.testing import CliRunner

from motord.bus.messages.table import TYPES, type_hash
from motord.cli import cli
from motord.cli.common import Exit

rosbags = pytest.importorskip("rosbags.typesys", reason="needs rosbags")

MESSAGES = sorted(name for name in TYPES if name.startswith("motord_msgs/msg/"))
ACTIONS = sorted(
    name.removesuffix("_Goal")
    for name in TYPES
    if name.startswith("motord_msgs/action/") and name.endswith("_Goal")
)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workspace") / "src"
    result = CliRunner().invoke(cli, ["ros2-msgs", str(folder)])
    assert result.exit_code == Exit.DONE, result.output
    assert "colcon build" in result.stdout
    return folder / "motord_msgs"


@pytest.fixture(scope="module")
def known(package):
    """A store of all types of Jazzy, and of those in the package's files."""
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    for path in package.glob("msg/*.msg"):
        name = f"motord_msgs/msg/{path.stem}"
        store.register(rosbags.get_types_from_msg(path.read_text(encoding="utf-8"), name))
    for path in package.glob("action/*.action"):
        parts = re.split(r"^---$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        for part, text in zip(("Goal", "Result", "Feedback"), parts, strict=True):
            name = f"motord_msgs/action/{path.stem}_{part}"
            store.register(rosbags.get_types_from_msg(text, name))
    return store


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_is_read_as_the_type_that_we_publish(known, name):
    assert known.hash_rihs01(name) == type_hash(name)


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize("part", ["Goal", "Result", "Feedback"])
def test_an_action_is_read_as_the_types_that_we_serve(known, name, part):
    assert known.hash_rihs01(f"{name}_{part}") == type_hash(f"{name}_{part}")


def test_the_build_names_each_file_and_what_it_needs(package):
    build = (package / "CMakeLists.txt").read_text(encoding="utf-8")
    paths = (*package.glob("msg/*"), *package.glob("action/*"))
    written = {str(path.relative_to(package)) for path in paths}
    assert set(re.findall(r'"((?:msg|action)/.*)"', build)) == written
    assert len(written) == len(MESSAGES) + len(ACTIONS)
    needs = re.search(r"DEPENDENCIES (.*)", build)[1].split()
    assert needs == ["action_msgs", "std_msgs"]
    found = re.findall(r"find_package\((\w+) REQUIRED\)", build)
    assert set(found) == {"ament_cmake", "rosidl_default_generators", *needs}
    manifest = fromstring((package / "package.xml").read_text(encoding="utf-8"))
    assert manifest.findtext("name") == "motord_msgs"
    assert [need.text for need in manifest.findall("depend")] == needs
    assert manifest.findtext("member_of_group") == "rosidl_interface_packages"
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest.findtext("version"))


def test_a_package_that_is_there_is_left_as_it_is(package):
    changed = package / "msg" / "MotorStatus.msg"
    before = changed.read_text(encoding="utf-8")
    result = CliRunner().invoke(cli, ["ros2-msgs", str(package.parent)])
    assert result.exit_code == Exit.USAGE
    assert "is there already" in result.stderr
    assert changed.read_text(encoding="utf-8") == before


def test_a_folder_that_cannot_be_made_is_reported(tmp_path):
    file = tmp_path / "file"
    file.touch()
    result = CliRunner().invoke(cli, ["ros2-msgs", str(file)])
    assert result.exit_code == Exit.FAILED
    assert "Not a directory" in result.stderr
    assert list(tmp_path.iterdir()) == [file]
