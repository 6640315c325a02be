# SPDX-License-Identifier: Apache-2.0
"""Feeds never wait and never grow; sources drop commands rather than keep them; adapters are found
by name, and an adapter that cannot be made stops no other one."""

import asyncio
import contextlib
import json
import math
import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.unit.messages.bus_views import BODY, LOOP, MS, imu, joint, message, view

from motord.bus.adapters import INPUT_POINTS, INPUTS, PUBLISHER_POINTS, PUBLISHERS, find
from motord.bus.commands import link
from motord.bus.commands.link import Source, call
from motord.bus.feed import Feed
from motord.bus.messages.forms import as_message
from motord.bus.messages.json_form import decode, encode, plain
from motord.bus.messages.table import TYPES
from motord.bus.messages.topics import TOPICS
from motord.bus.runtime import Runtime
from motord.bus.secret import Token, read_secret
from motord.client import ClientError, Refused
from motord.config import load_robot
from motord.config.sections.bus import ALL_TOPICS

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
DEADLINE_S = 20.0
BATTERY = {
    "state": "normal", "voltage_v": 24.0, "current_a": -1.0, "temperature_c": None,
    "capacity_ah": 10.0, "cells": 6, "stamp_ns": 1 * MS,
}  # fmt: skip


async def taken(feed, count):
    found = []
    async with asyncio.timeout(DEADLINE_S):
        async for message in feed:
            found.append(message)
            if len(found) == count:
                break
    return found


async def test_each_topic_keeps_its_newest_message_and_counts_the_lost():
    feed = Feed(BODY, {"odom": 1000.0, "tf": 1000.0})
    for at_ms in (1, 2, 3):
        feed.offer(view(at_ms, x_m=float(at_ms)))
    odom, tf = await taken(feed, 2)
    assert odom.message["pose"]["pose"]["position"]["x"] == 3.0
    assert tf.message["transforms"][0]["transform"]["translation"]["x"] == 3.0
    assert (feed.dropped, feed.taken) == (4, 2)


async def test_a_measurement_is_sent_once_with_one_stamp():
    feed, found = Feed(BODY, {"odom": 100.0, "tf": 30.0}), []
    for at_ms in range(1, 200):
        feed.offer(view(at_ms, odometry_stamp_ns=at_ms // 25 * 25 * MS))
        if feed._newest:
            found += await taken(feed, len(feed._newest))
    stamps = {"odom": [], "tf": []}
    for topic, sent in found:
        head = sent["transforms"][0] if topic.name == "tf" else sent
        stamps[topic.name].append(tuple(head["header"]["stamp"].values()))
    for times in stamps.values():
        assert times == sorted(set(times))
    assert set(stamps["tf"]) < set(stamps["odom"])
    assert len(stamps["odom"]) == 7, "each measurement, as soon as there is one"


async def test_an_older_measurement_than_the_last_one_is_not_sent():
    feed = Feed(BODY, {"imu": 1000.0, "diagnostics": 1000.0})
    stamps = []
    for at_ms, sample_ms in ((1, 9), (10, 8), (20, 9), (30, 10)):
        feed.offer(view(at_ms, imu=imu(sample_ms)))
        found = await taken(feed, len(feed._newest))
        stamps += [one.message["header"]["stamp"] for one in found if one.topic.name == "imu"]
    assert len(stamps) == 2


async def test_robots_of_another_file_are_counted_as_lost_and_offers_go_on():
    feed = Feed(BODY, {"joint_states": 1000.0, "diagnostics": 1000.0})
    feed.offer(view(1, joints=(joint(),)))
    assert feed.dropped == 1
    feed.offer(view(20))
    found = await taken(feed, 2)
    assert {one.topic.name for one in found} == {"joint_states", "diagnostics"}


async def test_a_message_that_a_bus_cannot_encode_is_lost_and_the_next_is_sent():
    def form(topic, body):
        def made(view, offset_ns):
            if view.snapshot.x_m < 0:
                raise ValueError("negative")
            return f"{topic.name} {view.snapshot.x_m:g}"

        return made

    feed = Feed(BODY, {"odom": 1000.0}, form)
    feed.offer(view(1, x_m=-1.0))
    task = asyncio.create_task(taken(feed, 1))
    async with asyncio.timeout(DEADLINE_S):
        while not feed.dropped:
            await asyncio.sleep(0)
    feed.offer(view(2, x_m=2.0))
    (one,) = await task
    assert (one.message, feed.taken, feed.dropped) == ("odom 2", 1, 1)


@given(
    rate_hz=st.floats(0.01, 1000),
    gaps_ms=st.lists(st.integers(1, 300), min_size=1, max_size=60),
)
def test_no_topic_is_offered_faster_than_its_rate(rate_hz, gaps_ms):
    feed, at_ms = Feed(BODY, {"odom": rate_hz}), 1
    for gap_ms in gaps_ms:
        feed.offer(view(at_ms))
        at_ms += gap_ms
    kept = feed.dropped + len(feed._newest)
    assert 1 <= kept <= 2 + sum(gaps_ms) / 1000 * rate_hz


async def test_a_topic_without_a_valid_message_is_left_out():
    feed = Feed(BODY, {"odom": 1000.0, "loop_statistics": 1000.0, "diagnostics": 1000.0})
    feed.offer(view(1, x_m=math.nan))
    (one,) = await taken(feed, 1)
    assert (one.topic.name, feed.taken) == ("diagnostics", 1)


def test_an_unknown_topic_is_a_key_error():
    with pytest.raises(KeyError):
        Feed(BODY, {"odour": 1.0})


def test_the_commander_holds_the_lease_of_the_snapshot():
    leases = [{"number": 4, "owner": "web", "priority": 7, "why": "in command: the only one"}]
    assert view(1, {"leases": leases}, owner=4).commander().owner == "web"
    assert view(1, {"leases": leases}, owner=5).commander() is None
    assert view(1, owner=4).commander() is None


def test_the_reason_of_a_fault_is_sent_while_it_is_latched():
    reasons = {"why": ["input.ros2: by /teleop"]}
    faulty = view(1, reasons, faults=("estop",))
    assert message("motor_status", faulty, BODY, 0).why == ("input.ros2: by /teleop",)
    assert message("motor_status", view(1, reasons), BODY, 0).why == ()
    assert view(1, faults=("estop",)).why() == ()


@given(value=st.floats() | st.text() | st.integers() | st.booleans())
def test_json_has_null_for_nan_and_keeps_other_values(value):
    decoded = decode(encode({"a": [value, (value,)]}))
    odd = isinstance(value, float) and not math.isfinite(value)
    assert decoded == {"a": [None, [None]]} if odd else {"a": [value, [value]]}


def test_a_message_has_the_fields_of_its_type_and_nothing_else():
    def fields(type_name, found):
        assert list(found) == [field.name for field in TYPES[type_name]]
        for field in TYPES[type_name]:
            part = found[field.name]
            parts = [part] if field.count is None else part
            assert field.count in (None, 0) or len(parts) == field.count
            for one in () if field.primitive else parts:
                fields(field.kind, plain(one))

    for name, topic in TOPICS.items():
        status = {"loop": LOOP, "leases": [], "battery": BATTERY}
        found = as_message(topic, BODY)(view(1, status), 0)
        fields(topic.type_name, found)
        assert decode(encode(found)) == plain(found), name


@pytest.mark.parametrize("raw", ["{", b"\xff", "[" * 100_000])
def test_invalid_json_is_a_value_error(raw):
    with pytest.raises(ValueError):
        decode(raw)


@pytest.mark.parametrize("table", [PUBLISHERS, INPUTS], ids=["publishers", "inputs"])
def test_every_kind_of_the_tables_has_an_adapter(table):
    for kind in table:
        assert callable(find("here", kind, table, "no.such.group"))


def test_an_unknown_kind_is_named_with_the_known_ones():
    with pytest.raises(LookupError, match=r'input.x: .*"smoke".*mqtt'):
        find("input.x", "smoke", INPUTS, INPUT_POINTS)


@pytest.mark.parametrize("group", [PUBLISHER_POINTS, INPUT_POINTS])
def test_another_package_may_bring_a_kind(tmp_path, monkeypatch, group):
    name = f"smoke_{group.replace('.', '_')}"
    (tmp_path / f"{name}.py").write_text("class Smoke: pass\n", encoding="ascii")
    info = tmp_path / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Name: {name}\nVersion: 1.0\n", encoding="ascii")
    (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {name}:Smoke\n", encoding="ascii")
    monkeypatch.syspath_prepend(tmp_path)
    assert find("here", name, {}, group).__name__ == "Smoke"


def test_an_adapter_that_cannot_be_made_is_reported_and_others_are_made(tmp_path, caplog):
    text = DEMO.read_text(encoding="utf-8") + (
        '\n[publish.smoke]\nkind = "other"\nadapter = "smoke"\n'
        '[publish.prom]\nkind = "prometheus"\n'
        '[input.fleet]\nkind = "mqtt"\ntoken_file = "missing"\n'
    )
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    adapters = Runtime(load_robot(path), tmp_path / "no.sock")._adapters()
    assert [type(adapter).__name__ for adapter in adapters.values()] == ["PrometheusServer"]
    assert "publish.smoke is off" in caplog.text
    assert "input.fleet is off" in caplog.text


def secret_file(tmp_path, text, mode=0o600):
    path = tmp_path / "token"
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644])
def test_a_secret_that_others_can_read_is_refused(tmp_path, mode):
    with pytest.raises(ValueError, match="chmod 600"):
        read_secret(secret_file(tmp_path, "x" * 20, mode))


def test_a_short_token_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least 16"):
        Token(secret_file(tmp_path, "short\n"))


@given(
    shown=st.none()
    | st.integers()
    | st.text()
    | st.sampled_from(["x" * 20, "\ud800", "x" * 20 + "\udcff"])
    | st.lists(st.text())
)
def test_only_the_exact_token_is_accepted(tmp_path_factory, shown):
    token = Token(secret_file(tmp_path_factory.mktemp("secret"), "x" * 20 + "\n"))
    assert token.fits(shown) == (shown == "x" * 20)


@contextlib.asynccontextmanager
async def answering(path, answer, *, stay=False):
    """Serve `answer` to every request at the daemon's socket; yield the requests. `stay`: keep each
    connection open until the client closes it."""

    asked = []

    async def attend(reader, writer):
        try:
            asked.append(await reader.readline())
            writer.write(answer if isinstance(answer, bytes) else json.dumps(answer).encode())
            writer.write(b"\n")
            with contextlib.suppress(ConnectionError):
                await writer.drain()
            if stay:
                await reader.read()
        finally:
            writer.close()

    async with await asyncio.start_unix_server(attend, str(path)):
        yield asked


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        ({"error": {"code": -32000, "message": "not now"}}, Refused, "not now"),
        ({"error": {"code": -32601, "message": "no method"}}, ClientError, "no method"),
        (b"no JSON", ClientError, "sock does not answer in JSON"),
        (b"x" * (1 << 21), ClientError, "an answer without end"),
    ],
)
async def test_an_answer_without_a_result_is_an_error(tmp_path, answer, error, words):
    async with answering(tmp_path / "sock", answer):
        with pytest.raises(error, match=words):
            await call(tmp_path / "sock", "arm")


async def test_a_missing_socket_is_reported(tmp_path):
    with pytest.raises(ClientError, match="no daemon has this socket"):
        await call(tmp_path / "sock", "arm")


async def test_a_daemon_that_does_not_answer_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(link, "CALL_WITHIN_S", 0.05)
    with socket.socket(socket.AF_UNIX) as silent:
        silent.bind(str(tmp_path / "sock"))
        silent.listen()
        with pytest.raises(ClientError, match="no answer within"):
            await call(tmp_path / "sock", "arm")


async def test_without_a_lease_a_command_is_lost_and_counted(tmp_path):
    source = Source(tmp_path / "sock", "web")
    assert not source.drive(0.1, 0.0)
    assert (source.ready, source.lost, source.sent) == (False, 1, 0)


async def test_a_command_lost_to_a_full_socket_is_not_blamed_on_a_missing_lease(
    tmp_path,
):
    grant = {"result": {"socket": str(tmp_path / "door"), "token": "00" * 16, "number": 1}}
    source = Source(tmp_path / "sock", "web")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as door:
        door.bind(grant["result"]["socket"])
        async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
            running = tasks.create_task(source.run())
            async with answering(tmp_path / "sock", grant, stay=True):
                while not source.ready:
                    await asyncio.sleep(0.01)
                while source.drive(0.1, 0.0):
                    pass
                assert "is full" in source.why_lost
                door.close()
                assert not source.drive(0.1, 0.0)
                assert "Connection refused" in source.why_lost
                running.cancel()
    assert not source.drive(0.1, 0.0)
    assert "no lease" in source.why_lost


async def test_a_refused_lease_is_reported_once_and_requested_again(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(link, "LEASE_AGAIN_S", 0.01)
    source = Source(tmp_path / "sock", "web")
    refusal = {"error": {"code": -32000, "message": "the loop stands still"}}
    async with asyncio.timeout(DEADLINE_S), asyncio.TaskGroup() as tasks:
        running = tasks.create_task(source.run())
        async with answering(tmp_path / "sock", refusal) as asked:
            while len(asked) < 3:
                await asyncio.sleep(0.01)
        running.cancel()
    assert "stands still" in caplog.text
    assert len(caplog.records) == 1


def test_topics_are_those_that_a_robot_file_can_name():
    assert tuple(TOPICS) == ALL_TOPICS
