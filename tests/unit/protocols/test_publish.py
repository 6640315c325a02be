# SPDX-License-Identifier: Apache-2.0
"""Publishers: the data that arrives, its rate, and readers that fail: only snapshots are lost."""

import asyncio
import contextlib
import dataclasses
import json
import math
import os
import socket
import subprocess
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.api.snapshot import JointSnapshot, Snapshot
from motord.bus.publish import KINDS, open_publisher
from motord.bus.publish.snapshot_feed import SnapshotFeed, encode
from motord.bus.publish.stdout import StdoutPublisher
from motord.bus.publish.udp import UdpPublisher
from motord.config import StdoutPublish, UdpPublish

DEADLINE_S = 20.0
STDOUT = StdoutPublish(kind="stdout")
MS = 1_000_000


def joint(**changes):
    plain = {field.name: 0.0 for field in dataclasses.fields(JointSnapshot)}
    return JointSnapshot(**plain | {"enabled": None, "drive_faults": 0, "jumps": 0} | changes)


def snapshot(at_ms=0, **changes):
    plain = {field.name: 0.0 for field in dataclasses.fields(Snapshot)} | {"imu": None}
    words = {"reasons": ("command_stale",), "faults": (), "joints": (joint(), joint())}
    rest = {"stamp_ns": at_ms * MS, "tick": at_ms, "pose_covariance": (0.0,) * 6,
            "twist_covariance": (0.0,) * 3, "lateral_covariance": (0.0,) * 3,
            "version": 1}  # fmt: skip
    return Snapshot(**plain | words | rest | changes)


async def taken(feed, count):
    found = []
    async with asyncio.timeout(DEADLINE_S):
        async for raw in feed:
            found.append(json.loads(raw))
            if len(found) == count:
                break
    return found


async def test_the_newest_snapshot_is_kept_and_the_lost_are_counted():
    feed = SnapshotFeed("r2", 1000.0)
    for at_ms in (1, 2, 3):
        feed.offer(snapshot(at_ms))
    (found,) = await taken(feed, 1)
    assert (found["tick"], feed.dropped, feed.taken) == (3, 2, 1)


@given(
    rate_hz=st.floats(0.01, 1000),
    gaps_ms=st.lists(st.integers(0, 300), min_size=1, max_size=60),
)
def test_no_publisher_is_fed_faster_than_its_rate(rate_hz, gaps_ms):
    feed = SnapshotFeed("r2", rate_hz)
    at_ms, kept = 1, 0
    for gap_ms in gaps_ms:
        feed.offer(snapshot(at_ms))
        at_ms += gap_ms
        kept = feed.dropped + (feed._newest is not None)
    assert kept >= 1
    assert kept <= 2 + sum(gaps_ms) / 1000 * rate_hz


def test_json_is_the_snapshot_with_its_robot_and_its_wall_time():
    raw = encode("r2", snapshot(40, x_m=1.5), wall_ns=4_900_000_000)
    found = json.loads(raw)
    assert found["wall_time_s"] == pytest.approx(4.9)
    assert (found["robot"], found["x_m"], found["reasons"]) == ("r2", 1.5, ["command_stale"])
    assert b"\n" not in raw


@given(value=st.floats())
def test_a_snapshot_is_json_whatever_was_measured(value):
    measured = snapshot(x_m=value, joints=(joint(velocity_rad_s=value),))
    found = json.loads(encode("r2", measured, 0), parse_constant=pytest.fail)
    expected = value if math.isfinite(value) else None
    assert found["x_m"] == expected
    assert found["joints"][0]["velocity_rad_s"] == expected


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_the_table_can_be_opened(kind):
    section = {"stdout": STDOUT, "udp": UdpPublish(kind="udp")}[kind]
    assert type(open_publisher("mine", kind, section)).__name__.lower().startswith(kind)


def test_an_unknown_kind_is_named_with_the_known_ones():
    with pytest.raises(LookupError, match=r'publish.mine: .*"smoke".*stdout'):
        open_publisher("mine", "smoke", STDOUT)


def test_another_package_may_offer_a_kind(tmp_path, monkeypatch):
    (tmp_path / "smoke_signals.py").write_text(
        "class Smoke:\n    def __init__(self, name, section): self.name = name\n", encoding="ascii"
    )
    info = tmp_path / "smoke_signals-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: smoke-signals\nVersion: 1.0\n", encoding="ascii")
    (info / "entry_points.txt").write_text(
        "[motord.publishers]\nsmoke = smoke_signals:Smoke\n", encoding="ascii"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert open_publisher("mine", "smoke", STDOUT).name == "mine"


async def feeding(feed, publisher, until):
    """Offer snapshots like the daemon until the condition holds; return the time of the slowest
    turn of the event loop in seconds."""
    slowest_s, at_ms = 0.0, 1
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        running = tasks.create_task(publisher.run(feed))
        while not until():
            before_s = time.monotonic()
            feed.offer(snapshot(at_ms))
            at_ms += 1
            await asyncio.sleep(0.0005)
            slowest_s = max(slowest_s, time.monotonic() - before_s)
        running.cancel()
    return slowest_s


async def test_udp_sends_one_datagram_a_snapshot():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(DEADLINE_S)
        publisher = UdpPublisher("mine", UdpPublish(kind="udp", port=listener.getsockname()[1]))
        await feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: publisher.sent >= 3)
        ticks = [json.loads(listener.recv(65536))["tick"] for _ in range(3)]
        assert ticks == sorted(set(ticks))


async def test_udp_without_a_listener_goes_on():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]
    publisher = UdpPublisher("mine", UdpPublish(kind="udp", port=port))
    await feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: publisher.sent >= 5)


async def test_udp_reports_once_that_a_snapshot_cannot_be_sent(caplog):
    publisher = UdpPublisher("mine", UdpPublish(kind="udp", host="255.255.255.255"))
    await feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: publisher.dropped >= 5)
    assert len([row for row in caplog.records if row.levelname == "WARNING"]) == 1


async def test_udp_to_an_invalid_name_is_reported_and_goes_on(caplog):
    section = UdpPublish.model_construct(kind="udp", host="broker..example", port=9870, rate_hz=1.0)
    publisher = UdpPublisher("mine", section)
    await feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: bool(caplog.records))
    assert "broker..example has no address" in caplog.text


async def test_udp_without_a_socket_is_reported_and_goes_on(caplog, no_descriptor_left):
    publisher = UdpPublisher("mine", UdpPublish(kind="udp"))
    # the first look-up of a process loads modules from files
    await asyncio.get_running_loop().getaddrinfo("127.0.0.1", 1)
    with no_descriptor_left():
        await feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: bool(caplog.records))
    assert "no socket for 127.0.0.1: Too many open files" in caplog.text


@pytest.fixture
def pipe():
    """A publisher whose standard output is a pipe, and the pipe's reading end."""
    reader, writer = os.pipe()
    with os.fdopen(reader, "rb") as reading, os.fdopen(writer, "wb") as writing:
        with contextlib.redirect_stdout(writing):
            publisher = StdoutPublisher("mine", STDOUT)
        yield publisher, reading


async def test_stdout_gets_a_line_for_each_snapshot(pipe):
    publisher, reading = pipe
    feed = SnapshotFeed("r2", 1000.0)
    await feeding(feed, publisher, lambda: feed.taken >= 20)
    ticks = [json.loads(reading.readline())["tick"] for _ in range(3)]
    assert ticks == sorted(set(ticks))


async def test_a_reader_that_stops_reading_loses_snapshots_and_blocks_nothing(pipe):
    publisher, reading = pipe
    feed = SnapshotFeed("r2", 1000.0)
    slowest_s = await feeding(feed, publisher, lambda: publisher.dropped >= 50)
    assert slowest_s < DEADLINE_S / 2
    assert feed.taken > publisher.dropped
    os.set_blocking(reading.fileno(), False)
    while publisher._lines.qsize():  # so that the thread ends before the pipe is closed
        with contextlib.suppress(BlockingIOError):
            os.read(reading.fileno(), 65536)


async def test_a_reader_that_goes_away_ends_the_publisher_and_is_reported(pipe, caplog):
    publisher, reading = pipe
    reading.close()
    await feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: bool(caplog.records))
    assert "closed" in caplog.text


async def test_without_standard_output_nothing_is_written_anywhere(caplog):
    with contextlib.redirect_stdout(None):
        publisher = StdoutPublisher("mine", STDOUT)
    async with asyncio.timeout(DEADLINE_S):
        await publisher.run(SnapshotFeed("r2", 1.0))
    assert "no standard output" in caplog.text


STUCK = """
import asyncio, sys
sys.path[:0] = sys.argv[1:]
from tests.unit.protocols.test_publish import STDOUT, StdoutPublisher, SnapshotFeed, feeding
publisher = StdoutPublisher("mine", STDOUT)
asyncio.run(feeding(SnapshotFeed("r2", 1000.0), publisher, lambda: publisher.dropped > 5))
"""


def test_a_process_with_a_stuck_reader_can_end():
    path = [entry for entry in sys.path if entry]
    with subprocess.Popen([sys.executable, "-c", STUCK, *path], stdout=subprocess.PIPE) as process:
        try:
            assert process.wait(60) == 0
        finally:
            process.kill()
