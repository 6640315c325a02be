# SPDX-License-Identifier: Apache-2.0
"""Answers of ~/get_type_description for every type, without a network."""

import hashlib
import json
from types import SimpleNamespace

import pytest

from motord.bus.messages.cdr import decode, encode
from motord.bus.messages.table import TYPES, type_hash
from motord.bus.ros2.services.type_description import SERVICE, serve_types


class Served:
    """A node that has these types and serves their descriptions."""

    def __init__(self, *types):
        self.types = set(types)
        serve_types(self)

    def serve(self, name, kind, answer):
        assert (name, kind) == ("~/get_type_description", SERVICE)
        self._answer = answer

    async def ask(self, kind, sources=True):
        """Return the answer, encoded and decoded again."""
        request = SimpleNamespace(
            type_name="", type_hash=type_hash(kind), include_type_sources=sources
        )
        reply = f"{SERVICE}_Response"
        return decode(reply, bytes(encode(reply, await self._answer(request))))


def plain(value):
    if isinstance(value, SimpleNamespace):
        return {key: plain(item) for key, item in vars(value).items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("kind", TYPES)
async def test_a_described_type_has_the_hash_that_was_requested(kind):
    sent = await Served(kind).ask(kind)
    assert (sent.successful, sent.failure_reason) == (True, "")
    described = plain(sent.type_description)
    for one in (described["type_description"], *described["referenced_type_descriptions"]):
        for field in one["fields"]:
            assert field.pop("default_value") == ""
    text = json.dumps(described, separators=(", ", ": ")).encode()
    assert f"RIHS01_{hashlib.sha256(text).hexdigest()}" == type_hash(kind)


async def test_sources_are_the_texts_of_the_type_and_of_all_that_it_is_made_of():
    kind = "std_srvs/srv/Trigger"
    sent = await Served(kind).ask(kind)
    texts = {one.type_name: (one.encoding, one.raw_file_contents) for one in sent.type_sources}
    assert texts[kind] == ("srv", "---\nbool success\nstring message\n")
    assert texts["builtin_interfaces/msg/Time"] == ("msg", "int32 sec\nuint32 nanosec\n")
    assert texts[f"{kind}_Event"] == ("implicit", "")
    assert not (await Served(kind).ask(kind, sources=False)).type_sources


async def test_a_type_that_the_node_does_not_have_is_not_described():
    sent = await Served("std_msgs/msg/String").ask("std_msgs/msg/Header")
    assert not sent.successful
    assert type_hash("std_msgs/msg/Header") in sent.failure_reason
