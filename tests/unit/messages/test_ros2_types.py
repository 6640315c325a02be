# SPDX-License-Identifier: Apache-2.0
"""ROS 2 types: their hashes, and their definitions as others read them."""

from pathlib import Path

import pytest

from motord.bus.messages import table as types
from motord.bus.messages.__main__ import page as messages_page
from motord.bus.messages.description import DESCRIPTIONS, descriptions
from motord.bus.messages.table import TYPES, definition, type_hash
from motord.bus.messages.topics import TOPICS

rosbags = pytest.importorskip("rosbags.typesys", reason="needs rosbags")

# Hashes as `ros2 topic info -v` shows them.
SEEN = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "geometry_msgs/msg/Twist": "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    "nav_msgs/msg/Odometry": "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "action_msgs/msg/GoalStatusArray": (
        "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e"
    ),
    "action_msgs/srv/CancelGoal": (
        "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
    ),
}
FIBONACCI = """
=== example_interfaces/action/Fibonacci_Goal
int32 order
=== example_interfaces/action/Fibonacci_Result
int32[] sequence
=== example_interfaces/action/Fibonacci_Feedback
int32[] sequence
"""
SEEN_OF_FIBONACCI = {
    "SendGoal_Request": "3d088942b413247db536576f0286768c6be8fcd5d0c9a5d544f359fba090a238",
    "GetResult_Request": "c8a4f5e7d13b81286ee1043e2ecd084281cecf1ff06aaa799464f5f15479f003",
    "FeedbackMessage": "c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2",
}
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
# In rosbags' hashes `char` is a type of its own; in rosidl's it is uint8.
WITH_CHAR = ("rmw_dds_common", "service_msgs")
COMPARED = sorted(
    name for name in TYPES if name in STORE.fielddefs and not name.startswith(WITH_CHAR)
)


def test_no_type_is_defined_twice():
    names = [name for name, _ in types._parsed(types.COMMON + types.OWN + types.SERVICES
                                               + types.ACTIONS + types.GRAPH)]  # fmt: skip
    assert len(names) == len(set(names))


@pytest.mark.parametrize("name", SEEN)
def test_a_hash_is_the_one_that_ros_2_shows(name):
    assert type_hash(name) == f"RIHS01_{SEEN[name]}"


@pytest.mark.parametrize("part", SEEN_OF_FIBONACCI)
def test_the_parts_of_an_action_have_the_hashes_that_ros_2_shows(monkeypatch, part):
    defined = dict(types._parsed(FIBONACCI))
    monkeypatch.setattr(types, "TYPES", {**TYPES, **defined, **dict(types._actions(defined))})
    hashed = type_hash(f"example_interfaces/action/Fibonacci_{part}")
    assert hashed == f"RIHS01_{SEEN_OF_FIBONACCI[part]}"


@pytest.mark.parametrize("name", COMPARED)
def test_a_hash_is_the_one_of_another_implementation(name):
    assert type_hash(name) == STORE.hash_rihs01(name)


@pytest.mark.parametrize("name", sorted(name for name in TYPES if "/msg/" in name))
def test_a_definition_is_read_by_another_parser_as_the_same_type(name):
    store = rosbags.get_typestore(rosbags.Stores.EMPTY)
    store.register(rosbags.get_types_from_msg(definition(name), name))
    assert [field for field, _ in store.fielddefs[name][1]] == [f.name for f in TYPES[name]]
    if name in COMPARED or name.startswith("motord_msgs"):
        assert store.hash_rihs01(name) == type_hash(name)


ACTIONS = sorted(name[: -len("_Goal")] for name in TYPES if name.endswith("_Goal"))


@pytest.mark.parametrize("name", ACTIONS)
def test_an_actions_definition_has_its_three_parts(name):
    parts = types.action_definition(name).split("---\n")
    for part, text in zip(("Goal", "Result", "Feedback"), parts, strict=True):
        lines = [line.split() for line in text.splitlines()]
        assert lines == [[field.kind, field.name] for field in TYPES[f"{name}_{part}"]]


@pytest.mark.parametrize("topic", TOPICS)
def test_every_row_of_a_description_names_a_field_of_the_type_once(topic):
    described = DESCRIPTIONS[topic]
    paths = [row.path for row in described.rows]
    assert len(set(paths)) == len(paths)
    for path in paths:
        kind = described.type_name
        for name in path.split("."):
            (field,) = [f for f in TYPES[kind] if f.name == name.removesuffix("[0]")]
            kind = field.kind


def test_a_line_that_belongs_to_no_description_is_refused():
    with pytest.raises(ValueError, match=r"odom: 'header . = x' is no line"):
        descriptions("=== odom nav_msgs/msg/Odometry\nheader . = x")


def test_the_page_of_messages_follows_from_the_descriptions():
    page = Path(__file__).resolve().parents[3] / "docs/messages.md"
    assert page.read_text() == messages_page(), "python -m motord.bus.messages > docs/messages.md"
