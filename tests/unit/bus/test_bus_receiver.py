# SPDX-License-Identifier: Apache-2.0
"""The C receiver reads a TwistStamped as the command gate does."""

import math
import socket
import struct
import time
from types import SimpleNamespace
from unittest.mock import patch

import pytest
from _motord_bus import ffi, lib
from hypothesis import assume, given
from hypothesis import strategies as st

from motord.bus.commands.gate import AHEAD, FUTURE_S, OLD_S, ZERO_STAMP, NotTaken
from motord.bus.commands.link import Source
from motord.bus.messages.cdr import decode, encode
from motord.bus.ros2.commands import _as_mapping
from motord.bus.ros2.dds.receiver import Receiver

TYPE = "geometry_msgs/msg/TwistStamped"
TOKENS = b"a" * 16, b"b" * 16


def parsed(raw):
    out = ffi.new("stamped_twist *")
    return out if lib.twist_parse(raw, len(raw), out) == 0 else None


def message(sec, nanosec, frame, linear, angular):
    made = SimpleNamespace(sec=sec, nanosec=nanosec)
    twist = SimpleNamespace(
        linear=SimpleNamespace(x=linear, y=1.0, z=2.0),
        angular=SimpleNamespace(x=3.0, y=4.0, z=angular),
    )
    return SimpleNamespace(header=SimpleNamespace(stamp=made, frame_id=frame), twist=twist)


def big_endian(sec, nanosec, frame, linear, angular):
    text = frame.encode() + b"\0"
    pad = bytes(-(12 + len(text)) % 8)
    head = struct.pack(">iII", sec, nanosec, len(text)) + text + pad
    return bytes(4) + head + struct.pack(">6d", linear, 1.0, 2.0, 3.0, 4.0, angular)


FIELDS = (
    st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), st.text(max_size=40),
    st.floats(), st.floats(),
)  # fmt: skip


@given(st.tuples(*FIELDS))
def test_a_twist_is_read_as_python_reads_it_in_either_byte_order(fields):
    sec, nanosec, frame, linear, angular = fields
    assume("\0" not in frame)
    raw = bytes(encode(TYPE, message(*fields)))
    sent = decode(TYPE, raw)
    for one in (parsed(raw), parsed(big_endian(*fields))):
        assert repr(one.linear_m_s) == repr(sent.twist.linear.x) == repr(linear)
        assert repr(one.angular_rad_s) == repr(sent.twist.angular.z) == repr(angular)
        assert one.stamp_s == sec + nanosec * 1e-9


def understood(raw):
    try:
        return decode(TYPE, raw)
    except ValueError:
        return None


@given(st.binary(max_size=120), st.integers(0, 40))
def test_c_and_python_read_the_same_bytes_as_a_twist(tail, frame_bytes):
    raw = b"\0\1\0\0" + struct.pack("<iII", 5, 6, frame_bytes) + tail
    one = parsed(raw)
    text = raw[16 : 16 + frame_bytes].removesuffix(b"\0")
    assume(text.decode(errors="replace").encode() == text)  # C does not check the frame's name
    sent = understood(raw)
    assert (one is None) == (sent is None)
    if sent is not None:
        assert repr(one.linear_m_s) == repr(sent.twist.linear.x)


@given(st.binary(max_size=80))
def test_random_bytes_are_a_twist_only_where_python_reads_one_too(raw):
    assert parsed(raw) is None or understood(raw) is not None or raw[:2] == b"\0\0"


WHY = {1 + lib.TWIST_STAMP_ZERO: ZERO_STAMP, 1 + lib.TWIST_STAMP_AHEAD: AHEAD}


WALL_S = 1.8e9
EDGES_S = (0.0, 0.3, OLD_S, 2 * OLD_S, -FUTURE_S, math.nextafter(-FUTURE_S, -1.0), -1.0)


@given(st.floats() | st.sampled_from([0.0, *(WALL_S - edge for edge in EDGES_S)]))
def test_the_age_of_a_stamp_is_that_of_the_command_gate(stamped, stamp_s):
    out = ffi.new("double *")
    code = lib.stamp_age(stamp_s, WALL_S, out)
    with patch("motord.bus.commands.gate.time.time", return_value=WALL_S):
        why, gates_s = "", 0.0
        try:
            gates_s = stamped._age_s(stamp_s)
        except NotTaken as refused:
            why = str(refused)
    assert WHY.get(code, "") == why
    assert code != 0 or out[0] == gates_s


def test_c_reads_from_a_message_what_the_gate_reads(stamped):
    now = time.time_ns() - 200_000_000
    raw = bytes(encode(TYPE, message(now // 10**9, now % 10**9, "base_link", 0.5, math.nan)))
    (linear_m_s, angular_rad_s, lateral_m_s), age_s = stamped._twist(_as_mapping(decode(TYPE, raw)))
    one = parsed(raw)
    assert (one.linear_m_s, math.isnan(one.angular_rad_s)) == (linear_m_s, True)
    assert math.isnan(angular_rad_s)
    assert one.lateral_m_s == lateral_m_s
    assert age_s >= 0.2 - 1e-6


class Outlet:
    """A receiver without a thread: the test sends through it."""

    def __init__(self):
        self.number = lib.receiver_claim()

    @property
    def direct(self):
        return lib.receiver_direct(self.number)

    def hold(self, fd, token, sequence):
        lib.receiver_hold(self.number, fd, token, sequence)

    def let_go(self):
        return lib.receiver_let_go(self.number)

    def send(self, raw, seen):
        return lib.receiver_send(self.number, ffi.new("uint8_t[]", raw), len(raw), seen)


@pytest.fixture
def outlet():
    made = Outlet()
    yield made
    lib.receiver_release(made.number)


@pytest.fixture
def leased(tmp_path):
    ours, daemons = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    source = Source(tmp_path / "no.sock", "ros2")
    source._token, source._sender = TOKENS[0], ours
    daemons.settimeout(0)
    with ours, daemons:
        yield source, daemons


def numbers(daemons, count):
    found = [daemons.recv(200) for _ in range(count)]
    return [struct.unpack_from("<16sQ", raw, 8) for raw in found]


def test_command_numbers_continue_through_an_outlet_and_back(leased, outlet):
    source, daemons = leased
    assert source.drive(0.1, 0.0)
    source.lend(outlet)
    assert source.drive(0.2, 0.0)
    assert source.drive_joints([1.0, 1.0], 5)
    source.lend(None)
    assert source.release()
    assert numbers(daemons, 4) == [(TOKENS[0], n) for n in (1, 2, 3, 4)]
    assert source.sent == 4


def test_an_outlet_without_a_lease_sends_nothing_and_reports_why(leased, outlet):
    source, _ = leased
    source.lend(outlet)
    outlet.let_go()
    assert not source.drive(0.2, 0.0)
    assert (source.lost, source.sent) == (1, 0)
    assert "no lease" in source.why_lost


def test_a_motion_that_has_been_overtaken_sends_nothing(leased, outlet):
    source, daemons = leased
    source.lend(outlet)
    assert not source.drive(0.2, 0.0, seen=source.direct + 1)
    assert not source.release(seen=source.direct + 1)
    with pytest.raises(BlockingIOError):
        daemons.recv(200)
    assert source.lost == 0
    assert source.drive(0.2, 0.0, seen=source.direct)


def test_no_more_receivers_are_claimed_than_there_are():
    made = [lib.receiver_claim() for _ in range(lib.RECEIVERS_MAX)]
    assert len(set(made)) == lib.RECEIVERS_MAX
    assert lib.receiver_claim() < 0
    for number in made:
        lib.receiver_release(number)
    assert lib.receiver_stop(0) < 0
    assert lib.receiver_start(0, 1, 1) < 0


def test_a_receiver_that_could_not_be_opened_is_free_again(no_descriptor_left):
    """No failed try uses up a receiver: there are more tries than receivers."""
    for _ in range(lib.RECEIVERS_MAX + 1):
        receiver = Receiver(SimpleNamespace(ffi=ffi, lib=lib), SimpleNamespace(_ref=1))
        with no_descriptor_left(), pytest.raises(OSError, match="Too many open"), receiver.open():
            pass
        with pytest.raises(OSError, match="takes no listener"), receiver.open():
            pass
    number = lib.receiver_claim()
    assert number == 0
    lib.receiver_release(number)


def test_a_library_without_the_needed_functions_is_refused():
    assert lib.receiver_library(b"libc.so.6") < 0
    assert lib.receiver_library(b"no-such-library.so") < 0
