# SPDX-License-Identifier: Apache-2.0
"""The reader in plain Python sees what the C core writes, and nothing where a page is missing or
incomplete."""

import itertools
import json
import mmap
import os
import struct
import threading
import uuid

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st

from motord.api import state_page
from motord.api.page_file import own_page
from motord.api.state_page import NoPage, StatePage


@pytest.fixture
def page():
    """The name of a page, its path, and its open file, into which the C core writes."""
    name = f"t{uuid.uuid4().hex[:12]}"
    path = own_page(name)
    path.write_bytes(bytes(lib.PAGE_BYTES))
    with path.open("r+b") as file:
        yield name, path, file
    path.unlink(missing_ok=True)


def writing(file):
    view = mmap.mmap(file.fileno(), lib.PAGE_BYTES)
    raw = ffi.from_buffer("char[]", view, require_writable=True)
    assert lib.page_init(raw) == 0
    return raw


HEADER_BYTES = 32
"""The header's layout: everything before the number of snapshots, which changes."""
EDGES = (0, 1, 7, 63, 64, 4095, 4097, 16383, 16384, 16385, 1 << 31, (1 << 32) - 1)


def damaged_headers(whole):
    """Yield headers with one wrong byte, and with one or two wrong fields."""
    for place in range(len(whole)):
        for flip in (0x01, 0x10, 0x80, 0xFF):
            yield whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :]
    for value, other in itertools.product(EDGES, EDGES):
        for first, second in itertools.combinations_with_replacement(range(8, HEADER_BYTES, 4), 2):
            damaged = bytearray(whole)
            struct.pack_into("=I", damaged, first, value)
            struct.pack_into("=I", damaged, second, other)
            yield bytes(damaged)


def test_a_page_with_a_damaged_header_is_no_page_or_is_read_all_the_same(page):
    name, _, file = page
    raw = writing(file)
    state = ffi.new("robot_state *")
    for _ in range(5):
        lib.page_write(raw, state)
    refused = 0
    for damaged in damaged_headers(os.pread(file.fileno(), HEADER_BYTES, 0)):
        os.pwrite(file.fileno(), damaged, 0)
        try:
            with StatePage.open(name) as reader:
                reader.read()
        except NoPage:
            refused += 1
    assert refused > 1000


def test_a_reader_whose_page_gets_another_layout_reads_nothing_and_knows_that_it_is_gone(page):
    name, _, file = page
    raw = writing(file)
    lib.page_write(raw, ffi.new("robot_state *"))
    whole = os.pread(file.fileno(), HEADER_BYTES, 0)
    with StatePage.open(name) as reader:
        for damaged in damaged_headers(whole):
            os.pwrite(file.fileno(), damaged, 0)
            if damaged[: HEADER_BYTES - 4] != whole[: HEADER_BYTES - 4]:
                assert (reader.read(), reader.gone) == (None, True)
        os.pwrite(file.fileno(), whole, 0)
        assert reader.read() is not None
        assert not reader.gone


@given(raw=st.binary(min_size=ffi.sizeof("robot_state"), max_size=ffi.sizeof("robot_state")))
def test_any_bytes_decode_to_a_snapshot(raw):
    snapshot = state_page.decode(raw)
    assert len(snapshot.joints) <= lib.JOINTS_MAX
    json.dumps(snapshot.to_json(), allow_nan=False)


def test_the_newest_snapshot_is_read(page):
    name, _, file = page
    raw = writing(file)
    state = ffi.new("robot_state *")
    with StatePage.open(name) as reader:
        assert (reader.published, reader.read()) == (0, None)
        for tick in range(1, 12):
            state.tick, state.joint_count = tick, 2
            lib.page_write(raw, state)
            found = reader.read()
            assert (reader.published, found.tick, len(found.joints)) == (tick, tick, 2)


def test_a_snapshot_is_whole_while_the_writer_races(page):
    name, _, file = page
    raw, begun, ending = writing(file), threading.Event(), threading.Event()

    def write():
        state, tick = ffi.new("robot_state *"), 0
        while not ending.is_set():
            tick += 1
            state.tick, state.x_m, state.joint_count = tick, float(tick), 8
            state.joint[7].duty = float(tick)
            lib.page_write(raw, state)
            begun.set()

    writer = threading.Thread(target=write)
    writer.start()
    assert begun.wait(60)
    try:
        with StatePage.open(name) as reader:
            seen = [found for _ in range(3000) if (found := reader.read())]
    finally:
        ending.set()
        writer.join()
    assert seen
    assert all(found.tick == found.x_m == found.joints[7].duty for found in seen)


def test_a_file_that_is_not_a_page_is_not_read(page):
    name, path, _ = page
    with pytest.raises(NoPage, match="layout"):
        StatePage.open(name)
    os.truncate(path, 100)
    with pytest.raises(NoPage, match="being made"):
        StatePage.open(name)
    path.unlink()
    with pytest.raises(NoPage, match="No such file"):
        StatePage.open(name)


def test_a_page_that_was_removed_is_gone(page):
    name, path, file = page
    writing(file)
    with StatePage.open(name) as reader:
        assert not reader.gone
        path.unlink()
        assert reader.gone
        path.write_bytes(b"another")
        assert reader.gone
