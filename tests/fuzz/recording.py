# SPDX-License-Identifier: Apache-2.0
"""Mutated recordings, for `motord replay` and for `motord calibrate --from`: the reader reports why
a file cannot be used, or uses it. It never ends in a traceback, and never in the core's memory."""

from __future__ import annotations

import random
import struct
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Chunk, Header
from mcap.writer import MCAP0_MAGIC, Writer
from mcap_ros2.writer import Writer as RosWriter
from mutate import mutated
from tests.rt.core_walk import Walk, raw_bytes

from motord.api.geometry_fit import BadData, fit
from motord.bus.mcap.files import Entry, Recording
from motord.bus.messages.cdr import HEADER
from motord.bus.messages.journal import TOPIC, TYPE_NAME
from motord.bus.messages.table import definition
from motord.commission.calibrate.log_fit import read_csv, windows
from motord.commission.calibrate.mcap_log import read_mcap
from motord.commission.person import Failed
from motord.config import load_robot
from motord.config.robot_file import attached
from motord.control.assembly import core_config
from motord.realtime.replay import CHECKPOINT_BYTES, LAYOUT_VERSION, RECORD_BYTES
from motord.tools.replay import ReplayError, replay

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ("demo", "swerve4-can", "pan-tilt", "esp32-imu")
TICKS, SAMPLES = 40, 400
BOMB_PART, BOMB_BYTES = 0.02, 200 << 20
SIDES = {"left": "left", "right": "right"}
RADII_M = {"left": 0.08, "right": 0.08}
WORDS = (
    b"nan", b"inf", b"1e308", b"-1e300", b"-1", b"\xff" * 8, b"\x00" * 8, b"\xf8\xff" * 4,
    struct.pack("<d", 1e300), struct.pack("<I", 9), struct.pack("<Q", 1 << 62), b"9" * 400, b"{}",
    b"null", b"[]", b'"x"', b"\n\n", b",", b"time_s",
)  # fmt: skip
Change = Callable[[bytes], bytes]


def run(seed: int, runs: int) -> Iterator[tuple[str, bytes]]:
    """Yield each problem with its input."""
    dice = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        places = [_journal(Path(folder) / f"{name}.mcap", name, dice) for name in ROBOTS]
        originals = [(path, _replayed) for path in places]
        originals += [(_poses(Path(folder) / "log.mcap"), _fitted_mcap)]
        originals += [(_table(Path(folder) / "log.csv"), _fitted_csv)]
        for path, use in originals:
            if problem := _tried(use, path):
                yield f"the original: {problem}", path.read_bytes()
        for _ in range(runs):
            path, use = dice.choice(originals)
            changed = path.with_name(f"changed{path.suffix}")
            _change(dice, path, changed)
            if problem := _tried(use, changed):
                yield problem, changed.read_bytes()


def _tried(use: Callable[[Path], object], path: Path) -> str:
    try:
        use(path)
    except (ReplayError, Failed, BadData) as error:
        return "" if str(error) else "an error without a text"
    except Exception as error:  # noqa: BLE001  # any other exception is a finding
        return f"{type(error).__name__}: {error}"
    return ""


def _replayed(path: Path) -> None:
    replay(path)


def _fitted_mcap(path: Path) -> None:
    _fit(read_mcap(path, "/ground_truth", SIDES, RADII_M))


def _fitted_csv(path: Path) -> None:
    _fit(read_csv(path, SIDES, RADII_M))


def _fit(log) -> None:
    fit(windows(log), 0.45, ("scale", "ratio", "track"), robust=True)


# ----------------------------------------------------------------------------------- originals
def _journal(path: Path, name: str, dice: random.Random) -> Path:
    """Record a robot's core."""
    robot = load_robot(ROOT / f"config/robots/{name}.toml")
    walk = Walk(core_config(robot, robot.profiles), dice.randrange(1 << 30))
    entries = []
    for _ in range(3):
        state, records = raw_bytes(walk.state), []
        for _ in range(TICKS):
            walk.step()
            records.append(raw_bytes(walk.record))
        entries.append(Entry(TOPIC, TYPE_NAME, 10**18, _message(state, b"".join(records))))
    recording = Recording(path, name, attached(robot))
    recording.add(entries)
    recording.close()
    return path


def _message(states: bytes, records: bytes) -> bytes:
    packed = [zstandard.ZstdCompressor(level=1).compress(part) for part in (states, records)]
    out = HEADER + struct.pack("<3I", LAYOUT_VERSION, RECORD_BYTES, CHECKPOINT_BYTES)
    out += struct.pack("<I", len(packed[0])) + packed[0] + bytes(-len(packed[0]) % 4)
    return out + struct.pack("<I", len(packed[1])) + packed[1]


def _rows() -> Iterator[tuple[float, ...]]:
    """Yield time_s, x_m, y_m, heading_rad, left_rad, right_rad of a base that drives straight."""
    for place in range(SAMPLES):
        angle_rad = 0.5 * place
        yield 0.1 * place, 0.04 * place, 0.0, 0.0, angle_rad, 1.0001 * angle_rad


def _table(path: Path) -> Path:
    rows = ["time_s,x_m,y_m,heading_rad,left_rad,right_rad"]
    rows += [",".join(map(str, row)) for row in _rows()]
    path.write_text("\n".join(rows), encoding="ascii")
    return path


def _poses(path: Path) -> Path:
    odometry, joints = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
    with path.open("wb") as sink, RosWriter(sink, chunk_size=4096) as writer:
        kinds = {
            kind: writer.register_msgdef(kind, definition(kind)) for kind in (odometry, joints)
        }
        for time_s, x_m, y_m, _, left_rad, right_rad in _rows():
            now_ns = round(time_s * 1e9)
            stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
            header = {"header": {"stamp": stamp, "frame_id": ""}}
            at = {"x": x_m, "y": y_m, "z": 0.0}
            turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
            pose = {"pose": {"pose": {"position": at, "orientation": turn}}}
            angles = {"name": ["left", "right"], "position": [left_rad, right_rad]}
            writer.write_message("/ground_truth", kinds[odometry], header | pose, now_ns, now_ns)
            writer.write_message("/joint_states", kinds[joints], header | angles, now_ns, now_ns)
    return path


# ------------------------------------------------------------------------------------- changes
def _bomb(dice: random.Random) -> bytes:
    """Return a file with a chunk that unpacks to far more than it may, whatever size it names."""
    packing = dice.choice(("zstd", "lz4"))
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[packing]
    size = dice.choice((BOMB_BYTES, 1000, 0, 1 << 62, dice.randrange(BOMB_BYTES)))
    builder = RecordBuilder()
    builder.write(MCAP0_MAGIC)
    for record in (Header("ros2", "fuzz"), Chunk(packing, pack(bytes(BOMB_BYTES)), 0, 0, 0, size)):
        record.write(builder)
    return builder.end()


def _change(dice: random.Random, path: Path, changed: Path) -> None:
    """Write a changed copy: of the bytes of the file, or of what is in it, with good checksums."""
    if path.suffix == ".mcap" and dice.random() < BOMB_PART:
        changed.write_bytes(_bomb(dice))
        return
    if path.suffix != ".mcap" or dice.random() < 0.4:
        changed.write_bytes(mutated(dice, path.read_bytes(), WORDS))
        return
    inner = dice.choice(("message", "state", "records", "attachment", "schema"))
    once = dice.randrange(3)

    def one(data: bytes) -> bytes:
        return mutated(dice, data, WORDS)

    def same_size(data: bytes) -> bytes:
        out = bytearray(data)
        for _ in range(dice.randint(1, 4)):
            at, word = dice.randrange(len(out)), dice.choice(WORDS)[:8]
            out[at : at + len(word)] = word
        return bytes(out[: len(data)])

    def journal(number: int, data: bytes) -> bytes:
        if number != once:
            return data
        if inner == "message":
            return one(data)
        states, records = _unpacked(data)
        return (
            _message(same_size(states), records)
            if inner == "state"
            else _message(states, same_size(records))
        )

    with path.open("rb") as file, changed.open("wb") as sink:
        writer = Writer(sink, chunk_size=4096)
        writer.start(profile="ros2", library="fuzz")
        reader = make_reader(file)
        for found in reader.iter_attachments():
            data = one(found.data) if inner == "attachment" and dice.random() < 0.6 else found.data
            writer.add_attachment(0, 0, found.name, found.media_type, data)
        channels = {}
        for number, (schema, of, message) in enumerate(reader.iter_messages()):
            if of.id not in channels:
                text = one(schema.data) if inner == "schema" else schema.data
                known = writer.register_schema(schema.name, schema.encoding, text)
                channels[of.id] = writer.register_channel(of.topic, of.message_encoding, known)
            data = message.data
            if schema.name == TYPE_NAME and inner in ("message", "state", "records"):
                data = journal(number, data)
            elif inner == "message" and dice.random() < 0.1:
                data = one(data)
            writer.add_message(channels[of.id], message.log_time, data, message.publish_time)
        writer.finish()


def _unpacked(data: bytes) -> tuple[bytes, bytes]:
    length = struct.unpack_from("<I", data, 16)[0]
    states = zstandard.ZstdDecompressor().decompress(data[20 : 20 + length])
    at = 20 + length + -length % 4
    records = zstandard.ZstdDecompressor().decompress(data[at + 4 :])
    return states, records
