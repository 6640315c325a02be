# SPDX-License-Identifier: Apache-2.0
"""JSON holds the same values as the message, with the fast encoder (msgspec) and the slow one."""

import json
import random

import pytest
from tests.unit.messages.bus_views import BODY, any_body, any_view, joint, view

from motord.bus.messages import json_form
from motord.bus.messages.forms import as_cdr, as_json, as_message
from motord.bus.messages.topics import TOPICS

OFFSET_NS = 1_700_000_000_000_000_000
ROUNDS = 150


@pytest.fixture(params=["msgspec", "stdlib"])
def _with_and_without_msgspec(request, monkeypatch):
    if request.param == "stdlib":
        monkeypatch.setattr(json_form, "encode", json_form.encode_slowly)
    else:
        pytest.importorskip("msgspec")


@pytest.mark.usefixtures("_with_and_without_msgspec")
@pytest.mark.parametrize("name", sorted(TOPICS))
def test_the_json_holds_what_the_message_holds(name):
    """Several views in sequence: data that an encoder keeps of one must not appear in the next."""
    topic, rng = TOPICS[name], random.Random(name)
    compared = 0
    for _ in range(ROUNDS):
        count = rng.choice((0, 1, 2, 2, 4, 5))
        body = any_body(rng, count)
        encode = as_json(topic, body)
        for _ in range(3):
            one = any_view(rng, count)
            message = as_message(topic, body)(one, OFFSET_NS)
            raw = encode(one, OFFSET_NS)
            if message is None:
                assert raw is None
                continue
            compared += 1
            assert json.loads(raw) == json.loads(json.dumps(json_form.plain(message)))
    assert compared > ROUNDS


@pytest.mark.usefixtures("_with_and_without_msgspec")
@pytest.mark.parametrize("form", [as_json, as_cdr])
def test_joints_that_the_robot_file_does_not_have_are_not_sent_under_the_names_of_others(form):
    """A daemon may have been started with another robot file of the same name."""
    assert len(BODY.joints) == 2
    encode = form(TOPICS["joint_states"], BODY)
    assert encode(view(1), OFFSET_NS)
    for count in (1, 3):
        with pytest.raises(ValueError, match=r"joints, and the robot file has 2"):
            encode(view(2, joints=(joint(),) * count), OFFSET_NS)


@pytest.mark.parametrize(
    "raw", ['{"id": "\\ud800"}', b'{"\\uDFFF": 1}', b'["\xed\xa0\x80"]', "[" * 100_000]
)
def test_lone_surrogates_and_deep_nesting_are_refused(raw):
    with pytest.raises(ValueError, match=r"surrogates|nested"):
        json_form.decode(raw)


def test_a_pair_of_surrogates_is_a_letter_and_numbers_that_json_does_not_have_pass():
    assert json_form.decode('["\\ud83e\\udd16", 1e999]') == ["\N{ROBOT FACE}", float("inf")]
