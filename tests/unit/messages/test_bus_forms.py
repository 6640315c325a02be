# SPDX-License-Identifier: Apache-2.0
"""The compiled encoders write what the message holds, byte for byte."""

import math
import random

import pytest
from tests.unit.messages.bus_views import LOOP, any_body, any_view, joint, message, view

from motord.bus.messages import cdr
from motord.bus.messages.forms import as_cdr, as_json, stamp_ns
from motord.bus.messages.sources import Body
from motord.bus.messages.topics import TOPICS, View

OFFSET_NS = 1_700_000_000_000_000_000
OFFSETS_NS = (OFFSET_NS, OFFSET_NS, OFFSET_NS - 1, -1)
"""Offsets of the clock for stamps within a second, across its end, and before 1970."""
ROUNDS = 150


def outcome(encode, one, offset_ns):
    try:
        return encode(one, offset_ns)
    except ValueError:
        return "refused"


@pytest.mark.parametrize("name", sorted(TOPICS))
def test_compiled_encoders_write_the_message_byte_for_byte(name):
    """Several views in sequence: data that an encoder keeps of one must not appear in the next."""
    topic, rng = TOPICS[name], random.Random(name)
    compared = 0
    for _ in range(ROUNDS):
        count = rng.choice((0, 1, 2, 2, 4, 5))
        body = any_body(rng, count)

        def field_by_field(one, offset_ns, body=body):
            found = message(name, one, body, offset_ns)
            return None if found is None else bytes(cdr.encode(topic.type_name, found))

        compiled = as_cdr(topic, body)
        for offset_ns in OFFSETS_NS:
            one = any_view(rng, count)
            expected = outcome(field_by_field, one, offset_ns)
            compared += isinstance(expected, bytes)
            assert outcome(compiled, one, offset_ns) == expected
    assert compared > ROUNDS


LEASES = {
    "leases": [{"number": 1, "owner": "fleet", "priority": 7, "why": "in command: the only one"}]
}
WORDS = (
    {"machine_state": 3}, {"armed": True}, {"at_rest": True}, {"faults": ("estop",)},
    {"reasons": ("linear_jerk",)}, {"owner": 1}, {"status": {"leases": []}},
)  # fmt: skip


@pytest.mark.parametrize("form", [as_cdr, as_json])
@pytest.mark.parametrize("change", WORDS, ids=lambda change: next(iter(change)))
def test_a_change_of_one_word_alone_is_encoded_at_once(form, change):
    topic, body = TOPICS["motor_status"], Body(robot="r2", joints=("left", "right"))
    encode = form(topic, body)
    words = {"owner": 1 if "status" in change else 2}
    before = view(5, status=LEASES, **words)
    after = view(5, **{"status": LEASES} | words | change)
    assert encode(before, OFFSET_NS) != encode(after, OFFSET_NS)
    assert encode(after, OFFSET_NS) == form(topic, body)(after, OFFSET_NS)


@pytest.mark.parametrize("name", sorted(TOPICS))
def test_a_stamp_is_read_from_the_bytes_as_the_message_has_it(name):
    body = Body(robot="r2", joints=("left", "right"))
    joints = (joint(voltage_v=24.0),) * 2
    one = View(snapshot=view(7, joints=joints).snapshot,
               status={"leases": (), "loop": LOOP}, status_ns=9)  # fmt: skip
    found = message(name, one, body, OFFSET_NS)
    raw = as_cdr(TOPICS[name], body)(one, OFFSET_NS)
    stamp = (found.transforms[0] if name == "tf" else found).header.stamp
    assert stamp_ns(name, raw) == stamp.sec * 10**9 + stamp.nanosec


@pytest.mark.parametrize("name", ["odom", "tf", "joint_states", "motor_status", "imu"])
def test_a_stamp_that_the_message_cannot_hold_is_refused(name):
    body = Body(robot="r2", joints=("left", "right"))
    with pytest.raises(ValueError, match=TOPICS[name].type_name):
        as_cdr(TOPICS[name], body)(view(5, x_m=math.pi), 2**31 * 10**9)
