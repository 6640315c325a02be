# SPDX-License-Identifier: Apache-2.0
"""Reading of MCAP files that may be damaged, or come from a stranger: whatever a file holds, its
reader ends in one error with a reason. Needs the extra `mcap`."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import zstandard
from mcap.decoder import DecoderFactory
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from motord_hal.base import bounded

_RECORD_BYTES_MAX = 1 << 28
CHUNK_BYTES_MAX = 64 << 20
"""Limit for an unpacked chunk; motord's own have 0.25 MiB, those of others some MiB."""
_ERRORS = (
    *(McapError, struct.error, zstandard.ZstdError),
    # what the library raises where numbers of a damaged file do not fit together
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError),
    *(RecursionError, RuntimeError, TypeError, ValueError),
)
Item = TypeVar("Item")
_Decode = Callable[[bytes], Any]


class DamagedFile(Exception):
    """The file is no complete MCAP file; the text contains path, place and reason."""


def messages(path: Path, topic: str) -> Iterator[bytes]:
    """Yield the data of the messages of a topic. Raises DamagedFile, OSError."""
    for _, channel, message in _items(path, _messages):
        if channel.topic == topic:
            yield message.data


def decoded_messages(
    path: Path, decoders: Iterable[DecoderFactory], more: tuple[type[Exception], ...]
) -> Iterator[tuple[str, Any]]:
    """Yield topic and decoded message of all messages. `more`: errors of the decoders beside those
    of Python. Raises DamagedFile, OSError."""

    def decoded(file: BinaryIO) -> Iterator[tuple[str, Any]]:
        known: dict[int, tuple[Channel, _Decode]] = {}
        for schema, channel, message in _messages(file):
            if channel.id not in known or known[channel.id][0] is not channel:
                known[channel.id] = (channel, _decoder(decoders, schema, channel))
            yield channel.topic, known[channel.id][1](message.data)

    yield from _items(path, decoded, more)


def attachments(path: Path) -> dict[str, bytes]:
    """Return the attached files by their names. Raises DamagedFile, OSError."""
    return {one.name: one.data for one in _items(path, _records) if isinstance(one, Attachment)}


def _items(
    path: Path,
    begin: Callable[[BinaryIO], Iterator[Item]],
    more: tuple[type[Exception], ...] = (),
) -> Iterator[Item]:
    errors: tuple[type[Exception], ...] = (*_ERRORS, *more)
    with bounded.opened(path) as file:
        items = begin(file)
        while True:
            try:
                item = next(items)
            except StopIteration:
                return
            except errors as error:
                reason = " ".join(str(error).split()) or type(error).__name__
                raise DamagedFile(
                    f"{path} is not a complete MCAP file (before byte {file.tell()}: {reason}): "
                    "mcap recover repairs one that was cut off"
                ) from error
            yield item


def _records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of the file in their order; chunks packed. The index at the file's end is
    not used: it can name any place as a chunk."""
    reader = StreamReader(
        file, emit_chunks=True, validate_crcs=True, record_size_limit=_RECORD_BYTES_MAX
    )
    yield from reader.records


def _messages(file: BinaryIO) -> Iterator[tuple[Schema | None, Channel, Message]]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in _records(file):
        for one in _opened(record) if isinstance(record, Chunk) else (record,):
            if isinstance(one, Schema):
                schemas[one.id] = one
            elif isinstance(one, Channel):
                channels.setdefault(one.id, one)
            elif isinstance(one, Message):
                channel = channels[one.channel_id]
                yield schemas[channel.schema_id] if channel.schema_id else None, channel, one


def _decoder(
    decoders: Iterable[DecoderFactory], schema: Schema | None, channel: Channel
) -> _Decode:
    for factory in decoders:
        if (decode := factory.decoder_for(channel.message_encoding, schema)) is not None:
            return decode
    raise ValueError(f"{channel.topic} has messages in {channel.message_encoding}, not in cdr")


def _opened(chunk: Chunk) -> list[McapRecord]:
    """Return the records in a chunk. Raises ValueError, ZstdError, or what the library raises."""
    data = _unpacked(chunk)
    if len(data) != chunk.uncompressed_size:
        raise ValueError(f"a chunk does not have the {chunk.uncompressed_size} bytes that it names")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("the checksum of a chunk is wrong")
    chunk.compression, chunk.data = "", data
    return breakup_chunk(chunk)


def _unpacked(chunk: Chunk) -> bytes:
    """Unpack a chunk, to at most a byte more than the size that it names, whatever its packed data
    say of themselves."""
    size = chunk.uncompressed_size
    if size > CHUNK_BYTES_MAX:
        raise ValueError(f"a chunk of {size} bytes, more than {CHUNK_BYTES_MAX}")
    match chunk.compression:
        case "":
            return chunk.data
        case "zstd":
            with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(chunk.data)) as reader:
                return reader.read(size + 1)
        case "lz4":
            import lz4.frame

            unpack = lz4.frame.LZ4FrameDecompressor()
            return bytes(unpack.decompress(chunk.data, max_length=size + 1))
        case other:
            raise ValueError(f'a chunk is packed by "{other[:20]}"')
