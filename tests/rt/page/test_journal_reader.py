# SPDX-License-Identifier: Apache-2.0
"""The reader of a journal, on the ring that the loop writes."""

import mmap
import os
import struct
import uuid

import pytest
import zstandard
from _motord_rt import ffi, lib

from motord.api.page_file import JOURNAL, PageFile
from motord.bus.messages.journal import Journal, NoJournal
from motord.realtime.replay import CHECKPOINT_BYTES, RECORD_BYTES, tick_of, tick_of_state

HEADER_BYTES = 64
EDGES = (0, 1, 7, 63, 64, 256, 4095, 4097, 1 << 31, (1 << 32) - 1)


class Writer:
    """A journal as the loop writes it, whose steps contain only their number."""

    def __init__(self, file):
        os.truncate(file.fd, lib.journal_bytes())
        self._memory = mmap.mmap(file.fd, lib.journal_bytes())
        self._journal = ffi.from_buffer(self._memory)
        assert lib.journal_init(self._journal) == 0
        self._state = ffi.new("core_state *")
        self._input = ffi.new("core_input *")
        self._out = ffi.new("setpoints *")
        self._snapshot = ffi.new("robot_state *")

    def step(self, count):
        for _ in range(count):
            lib.journal_before(self._journal, self._state)
            self._state.tick += 1
            self._out.tick = self._state.tick
            lib.journal_after(self._journal, self._input, 0.001, self._out, self._snapshot)

    def header(self):
        return bytes(self._memory[:HEADER_BYTES])

    def put_header(self, header):
        self._memory[:HEADER_BYTES] = header

    def close(self):
        ffi.release(self._journal)
        self._memory.close()


@pytest.fixture
def written():
    """A writer, and the name of its robot."""
    name = f"t{uuid.uuid4().hex[:11]}"
    file = PageFile.open(name, JOURNAL)
    writer = Writer(file)
    yield writer, name
    writer.close()
    file.close()


def parts(message):
    """Return the ticks of the states and of the records in a message."""
    at, found = 16, []
    for size, tick in ((CHECKPOINT_BYTES, tick_of_state), (RECORD_BYTES, tick_of)):
        length = struct.unpack_from("<I", message, at)[0]
        raw = zstandard.ZstdDecompressor().decompress(
            message[at + 4 : at + 4 + length], max_output_size=1 << 26
        )
        found.append([tick(raw[i : i + size]) for i in range(0, len(raw), size)])
        at += 4 + length + -length % 4
    return found


def everything(journal):
    states, records = [], []
    while (message := journal.message()) is not None:
        more = parts(message)
        states += more[0]
        records += more[1]
    return states, records


def test_a_reader_that_comes_in_time_gets_every_record_from_the_first(written):
    writer, name = written
    writer.step(1500)
    with Journal.open(name) as journal:
        assert everything(journal) == ([0, 1024], list(range(1, 1501)))
        assert journal.message() is None
        writer.step(2)
        assert everything(journal) == ([], [1501, 1502])
        assert journal.take_lost() == 0


@pytest.mark.parametrize("steps", [4097, 4600, 4848, 5000, 6144, 9999])
def test_a_late_reader_begins_at_the_state_before_its_first_record(written, steps):
    writer, name = written
    writer.step(steps)
    with Journal.open(name) as journal:
        states, records = everything(journal)
        assert records[0] - 1 in states
        assert records == list(range(records[0], steps + 1))
        assert len(records) > 2048
        assert journal.take_lost() == 0, "what was before it came is not lost to it"


def test_a_reader_that_fell_behind_resumes_at_a_state_and_counts_the_lost_records(written):
    writer, name = written
    writer.step(10)
    with Journal.open(name) as journal:
        assert everything(journal)[1] == list(range(1, 11))
        writer.step(6000)
        states, records = everything(journal)
        assert records[0] - 1 in states
        assert records == list(range(records[0], 6011))
        assert journal.take_lost() == records[0] - 11


def damaged_headers(whole):
    """Yield headers with one wrong byte, and with one wrong field."""
    for place in range(len(whole)):
        for flip in (0x01, 0x10, 0x80, 0xFF):
            yield whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :]
    for value in EDGES:
        for place in range(8, len(whole), 4):
            yield whole[:place] + struct.pack("=I", value) + whole[place + 4 :]


def test_a_journal_with_a_damaged_header_is_no_journal_or_is_read_all_the_same(written):
    writer, name = written
    writer.step(1500)
    refused = 0
    for damaged in damaged_headers(writer.header()):
        writer.put_header(damaged)
        try:
            with Journal.open(name) as journal:
                journal.message()
        except NoJournal:
            refused += 1
    assert refused > 100
