# SPDX-License-Identifier: Apache-2.0
"""Copies of a recording with a changed journal."""

import struct

import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

JOURNAL = "/core_journal"


def rewritten(path, target, change):
    """Write a copy in which `change(number, data)` replaces each journal message; None omits it."""
    with path.open("rb") as file, target.open("wb") as sink:
        writer = Writer(sink)
        writer.start(profile="ros2", library="test")
        reader = make_reader(file)
        for one in reader.iter_attachments():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        channel, messages = None, reader.iter_messages(topics=[JOURNAL])
        for number, (schema, of, message) in enumerate(messages):
            if channel is None:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channel = writer.register_channel(of.topic, of.message_encoding, known)
            data = change(number, message.data)
            if data is not None:
                writer.add_message(channel, message.log_time, data, message.publish_time)
        writer.finish()
    return target


def with_records(data, change):
    """Return the message with changed records, which lie behind the checkpoints."""
    at = 16 + 4 + struct.unpack_from("<I", data, 16)[0]
    at += -at % 4
    length = struct.unpack_from("<I", data, at)[0]
    records = zstandard.ZstdDecompressor().decompress(data[at + 4 : at + 4 + length])
    packed = zstandard.ZstdCompressor().compress(change(records))
    return data[:at] + struct.pack("<I", len(packed)) + packed


def flipped(number, data):
    """Flip one bit of the input in message 5; a change for `rewritten`."""
    if number != 5:
        return data
    size = struct.unpack_from("<I", data, 8)[0]
    at = size + 14  # the time between two ticks, in the second record's second word
    return with_records(data, lambda raw: raw[:at] + bytes((raw[at] ^ 1,)) + raw[at + 1 :])
