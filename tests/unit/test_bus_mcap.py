# SPDX-License-Identifier: Apache-2.0
"""Recordings: what other programs read in them, and what a full disk costs."""

import asyncio
import contextlib
import dataclasses
import json
import math
import os
import subprocess
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from motord.bus import message_types
from motord.bus.json_form import plain
from motord.bus.json_schema import schema_of
from motord.bus.publish.mcap import McapRecorder
from motord.bus.station import Station
from motord.bus.topics import TOPICS, View
from motord.config import McapPublish, load_robot
from motord.snapshot import JointSnapshot, Snapshot

DEMO = Path(__file__).resolve().parents[2] / "config/robots/demo.toml"
DEADLINE_S = 20.0


def snapshot(**changes):
    joint = {field.name: 0.0 for field in dataclasses.fields(JointSnapshot)}
    joint |= {"enabled": True, "drive_faults": 0, "jumps": 0, "stale": False}
    plain_values = {field.name: 0.0 for field in dataclasses.fields(Snapshot)}
    now = time.monotonic_ns()
    words = {"stamp_ns": now, "odometry_stamp_ns": now, "machine_state": 2, "reasons": (),
             "faults": (), "joints": (JointSnapshot(**joint),) * 2, "owner": 0, "tick": 1,
             "pose_covariance": (0.0,) * 6, "twist_covariance": (0.0,) * 3}  # fmt: skip
    flags = dict.fromkeys(("armed", "enabled", "at_rest", "odometry_degraded"), False)
    return Snapshot(**plain_values | flags | words | changes)


class Stage:
    """A recorder that runs, and views of a robot for it."""

    def __init__(self, folder, **settings):
        section = McapPublish(kind="mcap", folder=str(folder), rate_hz=1000.0, **settings)
        self.station = Station(load_robot(DEMO), folder / "no.sock")
        self.recorder = McapRecorder("tape", section, self.station)
        self.feed = self.station.feeds["tape"]
        self.folder = folder

    def files(self):
        return sorted(self.folder.glob("*.mcap"))

    async def until(self, condition, **changes):
        """Feed it until the condition holds."""
        async with asyncio.timeout(DEADLINE_S):
            while not condition():
                self.station.view = View(snapshot=snapshot(**changes))
                self.feed.offer(self.station.view)
                await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def recording(folder, **settings):
    settings = {"free_min_mb": 0} | settings
    stage = Stage(folder, **settings)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(stage.recorder.run())
        yield stage
        task.cancel()


def read(path):
    with path.open("rb") as file:
        return [
            (channel.topic, schema.name, message.log_time, json.loads(message.data))
            for schema, channel, message in make_reader(file).iter_messages()
        ]


async def test_what_was_fed_is_read_by_the_reader_of_mcap(tmp_path):
    async with recording(tmp_path, topics=("odom", "motor_status")) as stage:
        await stage.until(lambda: stage.files() and stage.feed.taken > 20, x_m=1.25)
    (path,) = stage.files()
    rows = read(path)
    assert len(rows) == stage.feed.taken
    assert {(topic, name) for topic, name, *_ in rows} == {
        ("/odom", "nav_msgs/msg/Odometry"),
        ("/motor_status", "motord_msgs/msg/MotorStatus"),
    }
    odometry = [row for row in rows if row[0] == "/odom"]
    assert all(row[3]["pose"]["pose"]["position"]["x"] == 1.25 for row in odometry)
    stamp = odometry[0][3]["header"]["stamp"]
    assert odometry[0][2] == stamp["sec"] * 10**9 + stamp["nanosec"]
    assert abs(odometry[0][2] - time.time_ns()) < 60e9


async def test_a_file_does_not_grow_for_ever_and_the_oldest_go_first(tmp_path):
    settings = {"file_s": 1.0, "total_max_mb": 1}
    async with recording(tmp_path, **settings) as stage:
        await stage.until(stage.files)
        first, *_ = stage.files()
        (tmp_path / "demo-00000000T000000-000000000-all.mcap").write_bytes(bytes(1_000_000))
        (tmp_path / "somebody's.mcap").write_bytes(bytes(1_000_000))
        await stage.until(lambda: len(stage.files()) >= 3)
        await stage.until(
            lambda: not (tmp_path / "demo-00000000T000000-000000000-all.mcap").exists()
        )
    assert (tmp_path / "somebody's.mcap").exists()
    assert first.exists()
    assert read(first)


async def test_a_disk_that_is_full_is_said_once_and_nothing_is_written(tmp_path, caplog):
    async with recording(tmp_path, free_min_mb=10_000_000) as stage:
        await stage.until(lambda: stage.feed.dropped > 0 and caplog.records)
    assert stage.files() == []
    assert len(caplog.records) == 1
    assert "No space left" in caplog.text


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 300 kB."""
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(tmp_path)], capture_output=True
    )
    if done.returncode != 0:
        pytest.skip("a small disk can be made by root only")
    yield tmp_path
    subprocess.run(["umount", "-l", str(tmp_path)], check=True)


async def test_a_disk_that_fills_up_while_recording_does_not_end_the_recorder(
    small_disk, caplog, monkeypatch
):
    monkeypatch.setattr("motord.bus.publish.mcap.AGAIN_S", 0.1)
    caplog.set_level("INFO")
    ballast = small_disk / "ballast"
    async with recording(small_disk) as stage:
        await stage.until(stage.files)
        with contextlib.suppress(OSError), ballast.open("wb") as file:
            file.write(os.urandom(400_000))
        await stage.until(lambda: "No space left" in caplog.text)
        ballast.unlink(missing_ok=True)
        await stage.until(lambda: "records again" in caplog.text)


async def test_a_flight_recorder_writes_what_led_to_the_fault_and_nothing_else(tmp_path):
    settings = {"mode": "fault", "before_s": 60.0, "after_s": 0.2, "topics": ("motor_status",)}
    async with recording(tmp_path, **settings) as stage:
        await stage.until(lambda: stage.feed.taken > 20)
        assert stage.files() == []
        await stage.until(stage.files, faults=("drive", "estop"))
        await stage.until(lambda: stage.recorder._recording is None, faults=("drive", "estop"))
    (path,) = stage.files()
    assert path.name.endswith("-drive-estop.mcap")
    faults = [row[3]["faults"] for row in read(path)]
    assert [] in faults
    assert faults[-1] == ["drive", "estop"]


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
def test_the_schema_of_a_topic_is_that_of_its_messages(topic):
    status = {"loop": {
        "rate_hz": 1.0, "policy": "SCHED_OTHER", "ticks": 1, "overruns": 0, "page_faults": 0,
        "lateness_us": dict.fromkeys(("p50", "p99", "p99_9", "max"), math.nan),
        "step_ns": dict.fromkeys(("p50", "p99", "p99_9", "max"), 1.0),
    }, "leases": []}  # fmt: skip
    body = Station(load_robot(DEMO), Path("no.sock")).body
    message = topic.build(View(snapshot=snapshot(), status=status), body, 0)
    assert type(message) is topic.message
    _fits(plain(message), schema_of(topic.message))


def _fits(value, schema):
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int,
             "number": (int, float), "null": type(None)}  # fmt: skip
    said = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    assert any(isinstance(value, kinds[kind]) for kind in said), (value, schema)
    if isinstance(value, dict):
        assert list(value) == schema["required"] == list(schema["properties"])
        for name, item in value.items():
            _fits(item, schema["properties"][name])
    if isinstance(value, list):
        for item in value:
            _fits(item, schema["items"])


def test_what_messages_are_not_made_of_has_no_schema():
    assert schema_of(message_types.Level) == {"type": "integer"}
    with pytest.raises(TypeError, match="made of"):
        schema_of(dict)
