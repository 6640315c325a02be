# SPDX-License-Identifier: Apache-2.0
"""Recordings: their content as other programs read it, and a full disk."""

import asyncio
import contextlib
import os
import subprocess
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from tests.unit.messages.bus_views import LOOP, MS, view

from motord.bus.commands.gate import NotTaken
from motord.bus.mcap.files import Entry, Folder
from motord.bus.mcap.manual import recorder
from motord.bus.mcap.recorder import McapRecorder
from motord.bus.mcap.waiting import ENTRY_BYTES, Waiting
from motord.bus.messages.forms import as_cdr
from motord.bus.messages.topics import TOPICS
from motord.bus.runtime import Runtime
from motord.config import McapPublish, load_robot
from motord.config.rules.recording import MESSAGE_BYTES
from motord.config.sections.bus import SLOW

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
DEADLINE_S = 20.0


class Stage:
    """A recorder that runs, and views of a robot for it."""

    def __init__(self, folder, **settings):
        section = McapPublish(kind="mcap", folder=str(folder), rate_hz=1000.0, **settings)
        self.runtime = Runtime(load_robot(DEMO), folder / "no.sock")
        self.recorder = McapRecorder("tape", section, self.runtime)
        self.feed = self.runtime.feeds["tape"]
        self.folder = folder

    def files(self):
        return sorted(self.folder.glob("*.mcap"))

    async def until(self, condition, status=None, **changes):
        """Feed views to the recorder until the condition holds."""
        async with asyncio.timeout(DEADLINE_S):
            while not condition():
                self.runtime.view = view(time.monotonic_ns() // MS, status, **changes)
                self.feed.offer(self.runtime.view)
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
    """Return the recorded messages: (topic, schema, time, message); check that the description of
    the robot comes first."""
    with path.open("rb") as file:
        first, *rows = [
            (channel.topic, schema.name, message.log_time, decoded)
            for schema, channel, message, decoded in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        ]
    assert first[:2] == ("/robot_description", "std_msgs/msg/String")
    assert first[3].data.startswith("<robot")
    return rows


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
    assert all(row[3].pose.pose.position.x == 1.25 for row in odometry)
    stamp = odometry[0][3].header.stamp
    assert odometry[0][2] == stamp.sec * 10**9 + stamp.nanosec
    assert abs(odometry[0][2] - time.time_ns()) < 60e9


async def test_files_are_limited_and_the_oldest_are_removed_first(tmp_path):
    settings = {"file_s": 1.0, "total_max_mb": 1}
    async with recording(tmp_path, **settings) as stage:
        await stage.until(stage.files)
        first, *_ = stage.files()
        (tmp_path / "demo-00000000T000000-000000000-all.mcap").write_bytes(bytes(1_000_000))
        (tmp_path / "another.mcap").write_bytes(bytes(1_000_000))
        await stage.until(lambda: len(stage.files()) >= 3)
        await stage.until(
            lambda: not (tmp_path / "demo-00000000T000000-000000000-all.mcap").exists()
        )
    assert (tmp_path / "another.mcap").exists()
    assert first.exists()
    assert read(first)


async def test_a_disk_that_is_full_is_reported_once_and_nothing_is_written(tmp_path, caplog):
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
    monkeypatch.setattr("motord.bus.mcap.recorder.AGAIN_S", 0.1)
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
    faults = [list(row[3].faults) for row in read(path)]
    assert [] in faults
    assert faults[-1] == ["drive", "estop"]


async def test_a_flight_recorder_forgets_what_is_too_old_for_its_file(tmp_path):
    settings = {"mode": "fault", "before_s": 30.0, "after_s": 0.0, "topics": ("odom",)}
    async with recording(tmp_path, **settings) as stage:
        old_ms = time.monotonic_ns() // MS - 60_000
        stage.feed.offer(view(old_ms, x_m=1.0))
        async with asyncio.timeout(DEADLINE_S):
            while stage.feed.taken == 0:
                await asyncio.sleep(0.005)
        await stage.until(lambda: stage.feed.taken > 20, x_m=2.0)
        await stage.until(stage.files, x_m=2.0, faults=("drive",))
        await stage.until(lambda: stage.recorder._recording is None, faults=("drive",))
    (path,) = stage.files()
    assert {row[3].pose.pose.position.x for row in read(path)} == {2.0}


STATUS = {"loop": LOOP, "leases": []}


async def test_other_readers_of_rosbag2_read_every_topic(tmp_path):
    async with recording(tmp_path) as stage:
        await stage.until(lambda: stage.files() and stage.feed.taken > 20, status=STATUS)
    (path,) = stage.files()
    seen = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, _, message in reader.iter_decoded_messages():
            seen[channel.topic] = (schema.name, message)
    assert {topic: name for topic, (name, _) in seen.items()} == {
        f"/{topic.name}": topic.type_name for topic in TOPICS.values()
    } | {"/robot_description": "std_msgs/msg/String", "/tf_static": "tf2_msgs/msg/TFMessage"}
    assert seen["/joint_states"][1].name == ["left", "right"]
    assert seen["/motor_status"][1].state == "idle"


async def test_rosbags_reads_the_odometry_of_a_recording(tmp_path):
    async with recording(tmp_path, topics=("odom",)) as stage:
        await stage.until(lambda: stage.files() and stage.feed.taken > 5, x_m=1.25)
    (path,) = stage.files()
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        by_topic = {connection.topic: connection for connection in reader.connections}
        connection = by_topic.pop("/odom")
        assert set(by_topic) == {"/robot_description"}
        found = [
            reader.deserialize(raw, connection.msgtype)
            for _, _, raw in reader.messages([connection])
        ]
    assert len(found) == stage.feed.taken
    assert {message.pose.pose.position.x for message in found} == {1.25}


def qualities(path):
    """Return the quality with which rosbag2 would offer each topic, as another library reads it."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        found = {one.topic: one.ext.offered_qos_profiles for one in reader.connections}
    assert {len(profiles) for profiles in found.values()} == {1}
    return {topic: profile for topic, (profile,) in found.items()}


async def test_what_was_latched_is_latched_again_when_it_is_played(tmp_path):
    async with recording(tmp_path, journal=False) as stage:
        await stage.until(lambda: stage.files() and stage.feed.taken > 20, status=STATUS)
    (path,) = stage.files()
    found = qualities(path)
    assert {
        topic for topic, one in found.items() if one.durability is QosDurability.TRANSIENT_LOCAL
    } == {"/robot_description", "/tf_static"}
    assert {one.reliability for one in found.values()} == {QosReliability.RELIABLE}
    assert found["/tf"].depth == 100
    assert found["/odom"].deadline == found["/odom"].lifespan == (9223372036, 854775807)


async def test_qualities_and_types_are_written_as_rosbag2_reads_them(tmp_path):
    """Qualities are numbers: Humble cannot read names; Jazzy expects names unless a record gives
    the version."""
    async with recording(tmp_path) as stage:
        await stage.until(lambda: stage.files() and stage.feed.taken > 20, status=STATUS)
    (path,) = stage.files()
    with path.open("rb") as file:
        reader = make_reader(file)
        channels = {one.topic: one for one in reader.get_summary().channels.values()}
        schemas = reader.get_summary().schemas
        (record,) = [one.metadata for one in reader.iter_metadata() if one.name == "rosbag2"]
    yaml, jazzy = YAML(typ="safe"), get_typestore(Stores.ROS2_JAZZY)
    assert yaml.load(record["serialized_metadata"])["version"] == 8
    for topic, profile in qualities(path).items():
        metadata = channels[topic].metadata
        assert yaml.load(metadata["offered_qos_profiles"]) == yaml.load(dump_qos_v8([profile]))
        name = schemas[channels[topic].schema_id].name
        if name in jazzy.fielddefs:
            assert metadata["topic_type_hash"] == jazzy.hash_rihs01(name)


FAULT = {"mode": "fault", "before_s": 60.0, "topics": ("motor_status",)}


async def test_a_process_that_ends_before_the_time_after_a_fault_is_over_saves_it(tmp_path):
    async with recording(tmp_path, **FAULT, after_s=60.0) as stage:
        await stage.until(lambda: stage.recorder._why is not None, faults=("drive", "estop"))
        assert stage.files() == []
    (path,) = stage.files()
    assert path.name.endswith("-drive-estop.mcap")
    assert [list(row[3].faults) for row in read(path)][-1] == ["drive", "estop"]


async def test_a_process_that_ends_while_the_robot_is_armed_saves_what_led_to_it(tmp_path):
    async with recording(tmp_path, **FAULT) as stage:
        await stage.until(lambda: stage.feed.taken > 20, armed=True)
    (path,) = stage.files()
    assert path.name.endswith("-lost.mcap")
    assert len(read(path)) == stage.feed.taken


async def test_a_daemon_that_is_lost_while_armed_leaves_a_file(tmp_path):
    async with recording(tmp_path, **FAULT) as stage:
        await stage.until(lambda: stage.recorder._armed, armed=True)
        stage.runtime.view = None
        async with asyncio.timeout(DEADLINE_S):
            while not stage.files() or stage.recorder._recording:
                await asyncio.sleep(0.01)
    (path,) = stage.files()
    assert path.name.endswith("-lost.mcap")
    assert read(path)


async def test_a_robot_that_is_at_rest_and_ends_leaves_no_file(tmp_path):
    async with recording(tmp_path, **FAULT) as stage:
        await stage.until(lambda: stage.feed.taken > 20)
    assert stage.files() == []


def entry(at_ns, size):
    return Entry("odom", "nav_msgs/msg/Odometry", at_ns, bytes(size))


def test_memory_is_bounded_in_bytes_and_what_is_lost_is_counted():
    waiting = Waiting(100_000)
    lost = sum(waiting.keep(entry(number, 750)) for number in range(1000))
    assert len(waiting) == 100
    assert lost == 900
    waiting.forget(950)
    assert [kept.log_ns for kept in waiting.take()] == list(range(950, 1000))
    assert sum(waiting.keep(entry(number, 750)) for number in range(100)) == 0
    assert waiting.keep(entry(0, 200_000)) == 101
    assert len(waiting) == 0


async def test_a_flight_recorder_counts_what_its_memory_does_not_hold(tmp_path):
    async with recording(tmp_path, **FAULT) as stage:
        stage.recorder._waiting = Waiting(10_000)
        await stage.until(lambda: stage.feed.dropped > 5)


NAMES = (
    "demo-20260101T000000-000000000-all.mcap",
    "demo-20260101T000000-000000000-estop.mcap",
    "demo-20260101T000000-000000000-all-estop.mcap",
    "demo-20260101T000000-000000000-manual.mcap",
    "demo-2-20260101T000000-000000000-all.mcap",
    "demo-2-20260101T000000-000000000-estop.mcap",
    "demo-all.mcap",
    "mine.mcap",
)


MODES = [("all", NAMES[:1]), ("fault", NAMES[1:3]), ("manual", NAMES[3:4])]


@pytest.mark.parametrize(("mode", "deleted"), MODES)
def test_only_recordings_of_this_robot_and_this_mode_are_removed(tmp_path, mode, deleted):
    for name in NAMES:
        (tmp_path / name).write_bytes(bytes(2_000_000))
    folder = Folder(tmp_path, "demo", mode=mode, total_max_mb=1, free_min_mb=0)
    folder.make_room()
    assert {path.name for path in tmp_path.iterdir()} == set(NAMES) - set(deleted)


async def test_a_recorder_that_is_started_and_stopped_writes_only_between_the_two(tmp_path):
    runtime = Runtime(load_robot(DEMO), tmp_path / "no.sock")
    section = McapPublish(
        kind="mcap", folder=str(tmp_path), rate_hz=1000.0, mode="manual", free_min_mb=0
    )
    made = recorder("tape", section, runtime)
    assert runtime.recorders == {"tape": made}

    async def until(condition):
        async with asyncio.timeout(DEADLINE_S):
            while not condition():
                runtime.view = view(time.monotonic_ns() // MS)
                for feed in runtime.feeds.values():
                    feed.offer(runtime.view)
                await asyncio.sleep(0.005)

    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(made.run())
        for count in (1, 2):
            await asyncio.sleep(0)
            assert runtime.feeds == {}
            assert made.state.file is None
            made.start()
            await until(lambda: made.state.file is not None)
            assert made.state.mode == "manual"
            path = tmp_path / made.state.file
            made.stop()
            await until(lambda: not runtime.feeds)
            assert len(list(tmp_path.glob("demo-*-manual.mcap"))) == count
            assert read(path)
        task.cancel()


async def test_a_recorder_that_is_stopped_as_soon_as_it_was_started_does_not_record(tmp_path):
    runtime = Runtime(load_robot(DEMO), tmp_path / "no.sock")
    section = McapPublish(kind="mcap", folder=str(tmp_path), mode="manual", free_min_mb=0)
    made = recorder("tape", section, runtime)
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(made.run())
        await asyncio.sleep(0)  # the task begins
        made.start()
        made.stop()
        for _ in range(10):
            await asyncio.sleep(0)
            assert (runtime.feeds, made.state.recording) == ({}, False)
        made.start()
        while not runtime.feeds:
            await asyncio.sleep(0)
        assert made.state.recording
        task.cancel()


def test_a_recorder_that_records_by_itself_is_neither_started_nor_stopped(tmp_path):
    stage = Stage(tmp_path)
    for act in (stage.recorder.start, stage.recorder.stop):
        with pytest.raises(NotTaken, match='mode = "manual"'):
            act()


def test_no_message_in_memory_is_longer_than_the_robot_files_check_assumes(tmp_path):
    stage = Stage(tmp_path)
    shown = view(1000, STATUS)
    sizes = [
        ENTRY_BYTES + len(made)
        for topic in TOPICS.values()
        if topic.name not in SLOW and (made := as_cdr(topic, stage.runtime.body)(shown, 0))
    ]
    assert len(sizes) >= 4
    assert max(sizes) <= MESSAGE_BYTES
