# SPDX-License-Identifier: Apache-2.0
"""Recordings of strangers: whatever a chunk says of its size, and whatever its packed data say, no
more than a bounded size is unpacked."""

import io
import tracemalloc

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from mcap.writer import MCAP0_MAGIC

from motord.base.mcap_file import CHUNK_BYTES_MAX, DamagedFile, attachments, messages

TOPIC = "/core_journal"
HUGE = 1 << 30
PIECE = bytes(1 << 20)
MEMORY_MAX = 4 * CHUNK_BYTES_MAX


def written(path, *records):
    """Write an MCAP file without an index."""
    builder = RecordBuilder()
    builder.write(MCAP0_MAGIC)
    for record in (Header("ros2", "test"), *records, DataEnd(0), Footer(0, 0, 0)):
        record.write(builder)
    builder.write(MCAP0_MAGIC)
    path.write_bytes(builder.end())
    return path


def content(data=b"good"):
    builder = RecordBuilder()
    Schema(data=b"", encoding="", id=1, name="x").write(builder)
    Channel(id=1, topic=TOPIC, message_encoding="cdr", metadata={}, schema_id=1).write(builder)
    Message(channel_id=1, data=data, log_time=0, publish_time=0, sequence=0).write(builder)
    return builder.end()


def chunk(packing, data, size, crc=0):
    return Chunk(packing, data, 0, 0, crc, size)


def zstd_of(size):
    """Return packed zeros, whose frame does not name their size."""
    packer = zstandard.ZstdCompressor().compressobj()
    return b"".join(packer.compress(PIECE) for _ in range(size // len(PIECE))) + packer.flush()


def sized_zstd(size):
    """Return packed zeros, whose frame names their size."""
    sink = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(sink, size=size, closefd=False) as packer:
        for _ in range(size // len(PIECE)):
            packer.write(PIECE)
    return sink.getvalue()


def lz4_of(size):
    packer = lz4.frame.LZ4FrameCompressor()
    pieces = [packer.begin(), *(packer.compress(PIECE) for _ in range(size // len(PIECE)))]
    return b"".join((*pieces, packer.flush()))


PACKED = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}
BOMBS = {
    "zstd": ("zstd", zstd_of),
    "zstd with its size": ("zstd", sized_zstd),
    "lz4": ("lz4", lz4_of),
}


@pytest.mark.parametrize("packing", PACKED)
def test_a_chunk_is_read_however_it_is_packed(tmp_path, packing):
    data = content()
    path = written(tmp_path / "a.mcap", chunk(packing, PACKED[packing](data), len(data)))
    assert list(messages(path, TOPIC)) == [b"good"]


@pytest.mark.parametrize("named", [HUGE, 1000, 0], ids=["as it is", "small", "none"])
@pytest.mark.parametrize("bomb", BOMBS)
def test_a_chunk_that_unpacks_to_a_gigabyte_is_refused_before_it_is_unpacked(tmp_path, bomb, named):
    packing, packed = BOMBS[bomb]
    path = written(tmp_path / "a.mcap", chunk(packing, packed(HUGE), named))
    tracemalloc.start()
    with pytest.raises(DamagedFile, match=r"a chunk (of 1073741824|does not have)"):
        list(messages(path, TOPIC))
    assert tracemalloc.get_traced_memory()[1] < MEMORY_MAX
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("damaged", "why"),
    [
        (chunk("zstd", b"no frame", 100), "before byte"),
        (chunk("lz4", b"no frame", 100), "before byte"),
        (chunk("bzip2", content(), len(content())), 'a chunk is packed by "bzip2"'),
        (chunk("", content(), len(content()), crc=1), "the checksum of a chunk is wrong"),
    ],
)
def test_a_damaged_chunk_is_named_with_its_place(tmp_path, damaged, why):
    path = written(tmp_path / "a.mcap", damaged)
    with pytest.raises(DamagedFile, match=why) as caught:
        list(messages(path, TOPIC))
    assert "\n" not in str(caught.value)


def test_attachments_are_read_without_unpacking_chunks(tmp_path):
    robot = Attachment(0, 0, "robot.toml", "application/toml", b"[robot]")
    path = written(tmp_path / "a.mcap", chunk("zstd", b"no frame", 1), robot)
    assert attachments(path) == {"robot.toml": b"[robot]"}
