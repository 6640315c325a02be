# SPDX-License-Identifier: Apache-2.0
"""Keys, tokens, gids and attachments are those that rmw_zenoh nodes of Jazzy were seen to send, and
those of its design document."""

import pytest

from motord.bus.messages import table as types
from motord.bus.messages.table import Field, type_hash
from motord.bus.ros2.zenoh.names import (
    PUBLISHER,
    Attachment,
    NodeNames,
    gid,
    quality_text,
)

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
DDS_STRING = f"std_msgs::msg::dds_::String_/{STRING_HASH}"


def node(namespace="/", name="talker", domain_id=0, session_id="a52f44b281e33efee354a095ad96d9e9"):
    return NodeNames(domain_id=domain_id, session_id=session_id, namespace=namespace, name=name)


def seen(session_id, name, topic, quality):
    """Return a publisher's token, number 4 in its node, as it was on the wire."""
    return f"@ros2_lv/0/{session_id}/0/4/MP/%/%/{name}/%{topic}/{DDS_STRING}/{quality}"


SEEN = [
    (
        seen("45000cc3452ec777e9664270c90b5af", "p_be", "q_best_effort", "2::,10:,:,:,,"),
        {"reliable": False, "latched": False, "depth": 10},
        "150000000000000058d1b24cf9a2dc1810a4461b1ae3b3b1de4a54c9c5e9e88fd0",
    ),
    (
        seen("4d5b53bcdd3d15e71bef6b55f1997400", "p_depth42", "q_depth42", "::,:,:,:,,"),
        {"reliable": True, "latched": False, "depth": 42},
        "1500000000000000c2bec64cf9a2dc1810c4fac2c77aa599d761ccd1c0dd836e24",
    ),
    (
        seen("914ec2c920f5151f26394cf0ba959999", "p_tl", "q_transient", ":1:,10:,:,:,,"),
        {"reliable": True, "latched": True, "depth": 10},
        "15000000000000008903674cf9a2dc1810b9249d3fec6b1be4c0c8a0e3eb3550bb",
    ),
]


@pytest.mark.parametrize(("token", "quality", "attachment"), SEEN)
def test_a_publisher_has_the_token_and_attachment_of_one_of_ros_2(token, quality, attachment):
    parts = token.split("/")
    names = node(session_id=parts[2], name=parts[8])
    topic = parts[9].replace("%", "/")
    found = names.endpoint_token(4, PUBLISHER, topic, STRING, quality_text(**quality))
    assert found == token


@pytest.mark.parametrize(("token", "quality", "attachment"), SEEN)
def test_an_attachment_has_the_gid_of_its_publishers_token(token, quality, attachment):
    raw = bytes.fromhex(attachment)
    taken = Attachment.decode(raw)
    assert (taken.sequence, taken.gid) == (21, gid(token))
    assert taken.encode() == raw


def test_a_node_in_a_namespace_has_it_in_its_token_and_in_its_keys():
    names = node("/cell4", "gw", 7, "6977b59f87229328a8d406ad77b301a6")
    assert names.token() == "@ros2_lv/7/6977b59f87229328a8d406ad77b301a6/0/0/NN/%/%cell4/gw"
    assert names.key("/cell4/chatter", STRING) == f"7/cell4/chatter/{DDS_STRING}"


def test_the_hash_of_a_service_is_that_of_request_response_and_event_together(monkeypatch):
    name = "example_interfaces/srv/AddTwoInts"
    asked = (Field(name="a", kind="int64"), Field(name="b", kind="int64"))
    messages = {f"{name}_Request": asked, f"{name}_Response": (Field(name="sum", kind="int64"),)}
    services = dict(types._services(messages))
    monkeypatch.setattr(types, "TYPES", {**types.TYPES, **messages, **services})
    published = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    assert type_hash.__wrapped__(name) == published


@pytest.mark.parametrize("raw", [b"", bytes(32), bytes(33), bytes(34), b"\xff" * 33])
def test_an_invalid_attachment_is_refused(raw):
    with pytest.raises(ValueError, match="no attachment of rmw_zenoh"):
        Attachment.decode(raw)
