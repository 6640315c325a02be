# SPDX-License-Identifier: Apache-2.0
"""CDR, compared byte by byte with two other encoders."""

import random
from types import SimpleNamespace

import numpy as np
import pytest
from tests.unit.messages.ros2_values import any_message, same

from motord.bus.messages.cdr import HEADER, decode, encode
from motord.bus.messages.table import TYPES, definition

rosbags = pytest.importorskip("rosbags.typesys", reason="needs rosbags")
ROUNDS = 20


def as_a_message(text):
    """Return a type's name as that of a message: rosbags knows no others. Parts of services and
    actions have the same bytes, which contain no names."""
    return text.replace("/srv/", "/msg/").replace("/action/", "/msg/")


def as_rosbags(store, name, value):
    made = {}
    for field in TYPES[name]:
        item = getattr(value, field.name)
        if field.count is None:
            made[field.name] = item if field.primitive else as_rosbags(store, field.kind, item)
        elif not field.primitive:
            made[field.name] = [as_rosbags(store, field.kind, part) for part in item]
        elif field.kind == "string":
            made[field.name] = list(item)
        else:
            dtype = {"byte": "uint8", "char": "uint8"}.get(field.kind, field.kind)
            made[field.name] = np.array(item, dtype=dtype)
    return store.types[as_a_message(name)](**made)


def as_cyclone(name, value):
    from motord.bus.ros2.dds.cyclone_types import cyclone_type

    made = {}
    for field in TYPES[name]:
        item = getattr(value, field.name)
        if field.count is None:
            made[field.name] = item if field.primitive else as_cyclone(field.kind, item)
        elif not field.primitive:
            made[field.name] = [as_cyclone(field.kind, part) for part in item]
        else:
            made[field.name] = list(item)
    return cyclone_type(name)(**made)


@pytest.mark.parametrize("name", sorted(TYPES))
def test_rosbags_writes_the_same_bytes_and_what_it_writes_is_read(name):
    store, alias = rosbags.get_typestore(rosbags.Stores.EMPTY), as_a_message(name)
    parts = definition(name).replace("/srv/", "/").replace("/action/", "/")
    store.register(rosbags.get_types_from_msg(parts, alias))
    rng = random.Random(name)
    for _ in range(ROUNDS):
        message = any_message(rng, name)
        theirs = bytes(store.serialize_cdr(as_rosbags(store, name, message), alias))
        assert bytes(encode(name, message)) == theirs + bytes(-len(theirs) % 4)
        assert same(decode(name, theirs), message)


@pytest.mark.parametrize("name", sorted(TYPES))
def test_cyclone_writes_the_same_bytes_and_what_it_writes_is_read(name):
    pytest.importorskip("cyclonedds.idl", reason="needs cyclonedds")
    rng = random.Random(name)
    for _ in range(ROUNDS):
        message = any_message(rng, name)
        theirs = bytes(as_cyclone(name, message).serialize(use_version_2=False))
        assert bytes(encode(name, message)) == theirs + bytes(-len(theirs) % 4)
        assert same(decode(name, theirs), message)


@pytest.mark.parametrize("name", sorted(TYPES))
def test_what_was_encoded_is_decoded(name):
    rng = random.Random(name)
    for _ in range(ROUNDS):
        message = any_message(rng, name)
        assert same(decode(name, bytes(encode(name, message))), message)


@pytest.mark.parametrize("name", sorted(TYPES))
def test_a_message_that_is_cut_short_is_refused(name):
    rng = random.Random(name)
    raw = bytes(encode(name, any_message(rng, name)))
    for length in range(len(raw) - 3):
        try:
            decode(name, raw[:length])
        except ValueError:
            continue
        pytest.fail(f"{length} of {len(raw)} bytes passed")


@pytest.mark.parametrize("name", sorted(TYPES))
def test_noise_is_a_value_error_or_a_message_and_nothing_else(name):
    rng = random.Random(name)
    for _ in range(200):
        raw = HEADER + rng.randbytes(rng.randrange(120))
        try:
            decode(name, raw)
        except ValueError:
            continue


def test_a_sequence_that_claims_to_be_enormous_takes_no_memory():
    with pytest.raises(ValueError, match="longer than its bytes"):
        decode("sensor_msgs/msg/JointState", HEADER + bytes(8) + b"\1\0\0\0\0\0\0\0" + b"\xff" * 4)


def test_big_endian_and_other_encodings_are_refused():
    for header in (b"\0\0\0\0", b"\0\7\0\0", b"\0\3\0\0", b""):
        with pytest.raises(ValueError, match="little-endian"):
            decode("std_msgs/msg/String", header + bytes(8))


def test_a_value_that_does_not_fit_its_field_is_refused():
    with pytest.raises(ValueError, match="Time"):
        encode("builtin_interfaces/msg/Time", SimpleNamespace(sec=2**31, nanosec=0))
    with pytest.raises(ValueError, match="surrogates"):
        encode("std_srvs/srv/Trigger_Response", SimpleNamespace(success=True, message="\udc80"))
