# SPDX-License-Identifier: Apache-2.0
"""The folder of recordings: files with names of a fixed form, a limit of their total size, and a
minimum of free space on the disk."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import BufferedWriter
from pathlib import Path
from types import MappingProxyType

from mcap.writer import CompressionType, Writer

from motord.api.snapshot import SNAPSHOT_VERSION
from motord.bus.mcap.rosbag2 import METADATA, RECORD, channel_metadata
from motord.bus.messages.table import definition
from motord.config.robot_file import ATTACHED_FILE, ATTACHED_REST

MB = 1_000_000
CONTINUOUS = ("all", "manual")
"""Modes whose files have the mode in their names; other files have the reason for which they were
saved."""
CHUNK_BYTES = 256 * 1024
"""Size of a chunk. No more than that is lost when the process is killed; `mcap recover` repairs the
file."""
_MEDIA_TYPES = {ATTACHED_FILE: "application/toml", ATTACHED_REST: "application/json"}
_NO_FILES: Mapping[str, bytes] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Entry:
    """One message in ROS 2's encoding. `log_ns` is wall time."""

    topic: str
    type_name: str
    log_ns: int
    data: bytes


class Recording:
    """A file that is being written."""

    def __init__(self, path: Path, robot: str, attached: Mapping[str, bytes]) -> None:
        """Create the file, with these files in it. Raises OSError."""
        self.path, self.since_wall_time_s = path, time.time()
        self._file: BufferedWriter = path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="motord")
        self._writer.add_metadata(RECORD, METADATA)
        self._writer.add_metadata(
            "motord", {"robot": robot, "snapshot_version": str(SNAPSHOT_VERSION)}
        )
        for name, content in attached.items():
            now_ns = time.time_ns()
            self._writer.add_attachment(now_ns, now_ns, name, _MEDIA_TYPES[name], content)
        self._channels: dict[str, int] = {}
        self._sequence = 0

    def add(self, entries: Iterable[Entry]) -> None:
        """Write messages. Raises OSError."""
        for entry in entries:
            self._sequence += 1
            self._writer.add_message(
                channel_id=self._channel(entry.topic, entry.type_name),
                log_time=entry.log_ns,
                publish_time=entry.log_ns,
                sequence=self._sequence,
                data=entry.data,
            )
        self._file.flush()

    def _channel(self, topic: str, name: str) -> int:
        if topic not in self._channels:
            number = self._writer.register_schema(name, "ros2msg", definition(name).encode())
            self._channels[topic] = self._writer.register_channel(
                f"/{topic}", "cdr", number, channel_metadata(topic, name)
            )
        return self._channels[topic]

    def close(self) -> None:
        """Write the index that readers use, and close the file. Raises OSError; the file is closed
        then, too."""
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap's own
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file without an index: there is no room for it."""
        with contextlib.suppress(OSError):
            self._file.close()


class Folder:
    """All recordings of one robot and one mode."""

    def __init__(
        self, path: Path, robot: str, *, mode: str, total_max_mb: int, free_min_mb: int,
        attached: Mapping[str, bytes] = _NO_FILES,
    ) -> None:  # fmt: skip
        """`mode`: see `McapPublish.mode`; `attached`: files in each recording, by their names."""
        self._path = path
        self._robot = robot
        self._attached = attached
        what = mode if mode in CONTINUOUS else rf"(?!({'|'.join(CONTINUOUS)})\.)[^.]+"
        self._name = re.compile(rf"{re.escape(robot)}-\d{{8}}T\d{{6}}-\d{{9}}-{what}\.mcap")
        self._total_max_bytes = total_max_mb * MB
        self._free_min_bytes = free_min_mb * MB

    def open(self, what: str) -> Recording:
        """Begin a new file, ROBOT-TIME-WHAT.mcap. Raises OSError, with ENOSPC also before the disk
        is full."""
        self._path.mkdir(parents=True, exist_ok=True)
        self.make_room()
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
        name = f"{self._robot}-{stamp}-{time.time_ns() % 1_000_000_000:09d}-{what}.mcap"
        return Recording(self._path / name, self._robot, self._attached)

    def make_room(self, keep: Path | None = None) -> None:
        """Delete the oldest files of this robot and mode until the rest fits, but never `keep`.
        Raises OSError if there is too little room anyway."""
        files = sorted(file for file in self._path.iterdir() if self._name.fullmatch(file.name))
        sizes = {file: file.stat().st_size for file in files}
        for file in files:
            if sum(sizes.values()) <= self._total_max_bytes and self._has_room():
                return
            if file != keep:
                file.unlink(missing_ok=True)
                del sizes[file]
        if not self._has_room():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._path))

    def _has_room(self) -> bool:
        disk = os.statvfs(self._path)
        return disk.f_bavail * disk.f_frsize >= self._free_min_bytes
