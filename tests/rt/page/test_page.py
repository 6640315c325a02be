# SPDX-License-Identifier: Apache-2.0
"""The state page is as docs/state-page.md promises, for our reader and for the C one of docs/."""

import errno
import os
import re
import struct
import subprocess
from pathlib import Path

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st

from motord.api.page_file import SHARED, PageFile

ROOT = Path(__file__).resolve().parents[3]
STATE_BYTES = ffi.sizeof("robot_state")
LAYOUT = lib.PAGE_LAYOUT_VERSION
HEADER = struct.Struct("=8s6IQ24s")
SLOTS = 4


class Page:
    """Memory of a page's size and alignment."""

    def __init__(self):
        self.keep = ffi.new("uint8_t[]", lib.PAGE_BYTES + 64)
        start = -int(ffi.cast("uintptr_t", self.keep)) % 64
        self.pointer = self.keep + start
        self.bytes = ffi.buffer(self.pointer, lib.PAGE_BYTES)

    def write(self, payload: bytes):
        state = ffi.new("robot_state *")
        ffi.buffer(state)[:] = payload
        lib.page_write(self.pointer, state)

    def read(self) -> int | bytes:
        state = ffi.new("robot_state *")
        code = lib.page_read(self.pointer, state)
        return bytes(ffi.buffer(state)) if code == 0 else code


@pytest.fixture
def page():
    made = Page()
    assert lib.page_init(made.pointer) == 0
    return made


def payload_of(tick: int) -> bytes:
    return bytes((tick * 31 + place) % 256 for place in range(STATE_BYTES))


def test_memory_that_is_not_initialised_as_a_page_is_refused():
    assert Page().read() == -errno.EPROTO


def test_misaligned_memory_is_refused():
    assert lib.page_init(Page().pointer + 8) == -errno.EINVAL


def test_a_page_without_a_snapshot_has_no_data(page):
    assert page.read() == -errno.ENODATA


@given(st.lists(st.binary(min_size=STATE_BYTES, max_size=STATE_BYTES), min_size=1, max_size=9))
def test_the_newest_snapshot_is_read_bit_for_bit(payloads):
    made = Page()
    lib.page_init(made.pointer)
    for payload in payloads:
        made.write(payload)
        assert made.read() == payload


@given(place=st.integers(0, 27), flip=st.integers(1, 255))
def test_a_header_of_another_layout_is_refused(place, flip):
    made = Page()
    lib.page_init(made.pointer)
    made.write(payload_of(1))
    made.bytes[place] = bytes([made.bytes[place][0] ^ flip])
    assert made.read() == -errno.EPROTO


def test_the_header_is_the_documented_one(page):
    for tick in range(1, 6):
        page.write(payload_of(tick))
    magic, layout, payload, slots, stride, offset, pid, published, rest = HEADER.unpack(
        page.bytes[: HEADER.size]
    )
    assert HEADER.size == 64
    assert (magic, layout, payload, slots) == (b"MOTORD\0\1", LAYOUT, STATE_BYTES, SLOTS)
    assert (pid, published, rest) == (os.getpid(), 5, bytes(24))
    newest = offset + (published - 1) % slots * stride
    (sequence,) = struct.unpack("=Q", page.bytes[newest : newest + 8])
    assert sequence == 2 * published
    assert page.bytes[newest + 8 : newest + 8 + payload] == payload_of(5)


def test_a_reader_that_is_overtaken_in_every_try_gives_up(page):
    page.write(payload_of(1))
    page.bytes[64:72] = struct.pack("=Q", 2 * 5 - 1)  # the writer writes in that slot again
    assert page.read() == -errno.EAGAIN


def test_a_reinitialised_page_has_no_old_snapshot(page):
    page.write(payload_of(1))
    lib.page_init(page.pointer)
    assert page.read() == -errno.ENODATA
    page.write(payload_of(2))
    assert page.read() == payload_of(2)


@pytest.mark.parametrize(
    "struct_name",
    [
        "robot_state",
        "joint_state",
        "imu_state",
        "feedback_doubt",
        "lateral_state",
        "steering_state",
        "speed_loop_shown",
        "derating_shown",
        "reasons_shown",
    ],
)
def test_the_documented_offsets_are_those_of_the_compiler(struct_name):
    text = (ROOT / "docs/state-page.md").read_text(encoding="utf-8")
    section = text[text.index(f"`{struct_name}`, {ffi.sizeof(struct_name)} bytes") :]
    rows = re.findall(r"^\| (\d+) \| ([\w\[\]]+) \| `(\w+)` \|$", section, re.MULTILINE)
    fields = ffi.typeof(struct_name).fields
    assert rows[: len(fields)] == [(str(f.offset), f.type.cname, name) for name, f in fields]


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """docs/read_state.c, built with the command in its first line."""
    program = tmp_path_factory.mktemp("reader") / "read_state"
    source = ROOT / "docs/read_state.c"
    subprocess.run(
        ["gcc", "-Wall", "-Wextra", "-Werror", f"-I{ROOT / 'csrc'}", source, "-o", program],
        check=True,
        timeout=60,
    )
    return program


@pytest.fixture
def page_file():
    if not SHARED.is_dir():
        pytest.skip("no /dev/shm here")
    made = PageFile.open(f"test-page-{os.getpid()}")
    yield made
    made.close()


def run_reader(program, page_file) -> subprocess.CompletedProcess:
    return subprocess.run([program, page_file.path], capture_output=True, text=True, timeout=60)


def test_the_c_reader_of_the_docs_prints_the_same_numbers(reader, page_file):
    made = Page()
    lib.page_init(made.pointer)
    state = ffi.new("robot_state *")
    state.stamp_ns = lib.clock_now_ns()
    state.x_m, state.y_m, state.heading_rad = 1 / 3, -2e-7, 3.0000000000000004
    state.armed, state.faults = 1, 5
    for tick in range(1, 8):
        state.tick = tick
        lib.page_write(made.pointer, state)
    os.pwrite(page_file.fd, made.bytes[:], 0)
    words = run_reader(reader, page_file).stdout.split()
    printed = dict(zip(words[::2], words[1::2], strict=True))
    assert (printed["tick"], printed["armed"], printed["faults"]) == ("7", "1", "5")
    assert float(printed["x_m"]) == state.x_m
    assert float(printed["y_m"]) == state.y_m
    assert float(printed["heading_rad"]) == state.heading_rad
    assert float(printed["age_s"]) >= 0


def test_the_c_reader_refuses_what_is_not_a_page(reader, page_file):
    answer = run_reader(reader, page_file)
    assert (answer.returncode, answer.stdout) == (1, "")
    assert "no page there" in answer.stderr
    os.truncate(page_file.fd, lib.PAGE_BYTES)
    answer = run_reader(reader, page_file)
    assert (answer.returncode, answer.stdout) == (1, "")
    assert "not a page" in answer.stderr


@pytest.mark.parametrize("value", [0, 63, 16384, 1 << 31, (1 << 32) - 1])
@pytest.mark.parametrize("place", [8, 12, 16, 20, 24])
def test_the_c_reader_refuses_a_damaged_header(reader, page_file, place, value):
    made = Page()
    lib.page_init(made.pointer)
    for tick in range(1, 5):
        made.write(payload_of(tick))
    made.bytes[place : place + 4] = struct.pack("=I", value)
    os.pwrite(page_file.fd, made.bytes[:], 0)
    answer = run_reader(reader, page_file)
    assert (answer.returncode, answer.stdout) == (1, "")
    assert "not a page" in answer.stderr
