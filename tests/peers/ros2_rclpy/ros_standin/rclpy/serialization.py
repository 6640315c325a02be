# SPDX-License-Identifier: Apache-2.0
"""Messages as bytes."""

from motord.bus.messages.cdr import decode, encode


def serialize_message(message):
    return bytes(encode(message.KIND, message))


def deserialize_message(raw, kind):
    assert type(raw) is bytes, f"rclpy takes bytes, not {type(raw).__name__}"
    made = kind()
    vars(made).update(vars(decode(kind.KIND, raw)))
    return made
