# SPDX-License-Identifier: Apache-2.0
"""The reader in plain Python sees what the C core writes, and nothing where a page is missing or
incomplete."""

import json
import mmap
import os
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
