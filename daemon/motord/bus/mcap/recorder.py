# SPDX-License-Identifier: Apache-2.0
"""Records to MCAP files (mcap.dev), in the form of rosbag2: all messages, or those before and after
a fault.

A thread writes: while a disk stalls, messages are lost and counted, and nothing else happens. A
full disk is logged once, and writing is tried again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from typing import TYPE_CHECKING

from motord.bus.adapters import RecorderState
from motord.bus.commands.gate import NotTaken
from motord.bus.mcap.files import CONTINUOUS, Entry, Folder, Recording
from motord.bus.mcap.waiting import Waiting
from motord.bus.messages.cdr import encode
from motord.bus.messages.forms import as_cdr, stamp_ns
from motord.bus.messages.journal import TOPIC, TYPE_NAME, Journal, NoJournal
from motord.bus.messages.topics import TOPICS
from motord.bus.ros2.static_frames import STATIC, static_transforms
from motord.bus.ros2.urdf import DESCRIPTION, STRING, description, urdf
from motord.config import McapPublish
from motord.config.robot_file import attached
from motord.config.rules.recording import memory_bytes
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

WRITE_EVERY_S = 0.5
AGAIN_S = 5.0
JOURNAL_EVERY_S = 0.05
JOURNAL_AGAIN_S = 0.5
LOST = "lost"
"""Part of the name of a file that was saved because the daemon, or this process, ended while the
robot was armed."""

_log = logging.getLogger(__name__)


class McapRecorder:
    def __init__(self, name: str, section: McapPublish, runtime: Runtime) -> None:
        self._name = name
        self._section = section
        self._runtime = runtime
        self._feed = runtime.feed(name, section.rates_hz(), as_cdr)
        self._folder = Folder(
            runtime.beside_robot_file(section.folder),
            runtime.body.robot,
            mode=section.mode,
            total_max_mb=section.total_max_mb,
            free_min_mb=section.free_min_mb,
            attached=attached(runtime.robot) if section.journal else {},
        )
        self._latched = [(DESCRIPTION, STRING, description(runtime.robot))]
        if "tf" in section.topics:
            kind = TOPICS["tf"].type_name
            frames = static_transforms(urdf(runtime.robot), runtime.clock.now_ns())
            self._latched.append((STATIC, kind, bytes(encode(kind, frames))))
        self._waiting = Waiting(memory_bytes(runtime.robot))
        self._armed = False
        self._why: str | None = None
        """Fault whose file is not written yet; None: no such fault."""
        self._recording: Recording | None = None
        self._since_s = 0.0
        self._failing = self._ending = False
        self._writing = threading.Lock()
        """Lock that the writing thread holds: the thread may outlive the task that waited for
        it."""

    @property
    def state(self) -> RecorderState:
        """Implement `Recorder.state`."""
        recording = self._recording
        return RecorderState(
            mode=self._section.mode,
            recording=True,
            file=recording.path.name if recording is not None else None,
            since_wall_time_s=recording.since_wall_time_s if recording is not None else None,
            failing=self._failing,
        )

    def start(self) -> None:
        """Implement `Recorder.start`."""
        raise NotTaken(f'publish.{self._name} needs mode = "manual" to be started and stopped')

    stop = start

    def end(self) -> None:
        """Make `run` write what waits, close the file, and end. Only for modes other than
        "fault"."""
        self._ending = True

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        try:
            async with TaskGroup() as tasks:
                collecting = [tasks.create_task(self._collect())]
                if self._section.journal:
                    collecting.append(tasks.create_task(self._collect_journal()))
                await (self._all() if self._section.mode in CONTINUOUS else self._faults())
                for task in collecting:
                    task.cancel()
        finally:
            self._finish()

    async def _collect(self) -> None:
        async for topic, message in self._feed:
            stamp = stamp_ns(topic.name, message)
            self._keep(Entry(topic.name, topic.type_name, stamp, message))

    def _keep(self, entry: Entry) -> None:
        self._feed.dropped += self._waiting.keep(entry)

    async def _collect_journal(self) -> None:
        """Record what a replay needs, while a daemon writes it."""
        robot = self._runtime.body.robot
        while True:
            with contextlib.suppress(NoJournal), Journal.open(robot) as journal:
                try:
                    while not journal.gone:
                        self._keep_journal(journal)
                        await asyncio.sleep(JOURNAL_EVERY_S)
                finally:
                    self._keep_journal(journal)
            await asyncio.sleep(JOURNAL_AGAIN_S)

    def _keep_journal(self, journal: Journal) -> None:
        message = journal.message()
        if message is not None:
            self._keep(Entry(TOPIC, TYPE_NAME, self._runtime.clock.now_ns(), message))
        self._feed.dropped += journal.take_lost()

    # --------------------------------------------------------------------------------------- all
    async def _all(self) -> None:
        while not self._ending:
            await asyncio.sleep(AGAIN_S if self._failing else WRITE_EVERY_S)
            batch = self._waiting.take()
            try:
                await asyncio.to_thread(self._write, batch)
            except OSError as error:
                self._fail(error, len(batch))
            else:
                self._recovered()
        await asyncio.to_thread(self._finish)  # closing a file may take long

    def _write(self, batch: list[Entry]) -> None:
        """Write messages to the current file, and begin a new file after `file_s`. Runs in the
        writing thread. Raises OSError."""
        with self._writing:
            age_s = time.monotonic() - self._since_s
            if self._recording is not None and age_s > self._section.file_s:
                recording, self._recording = self._recording, None
                recording.close()
            if self._recording is None:
                self._recording = self._folder.open(self._section.mode)
                self._recording.add(self._described(batch))
                self._since_s = time.monotonic()
            else:
                self._folder.make_room(keep=self._recording.path)
            self._recording.add(batch)

    # ------------------------------------------------------------------------------------ faults
    async def _faults(self) -> None:
        """Save a file each time that a fault is latched, and when the daemon is lost while
        armed."""
        latched = False
        while True:
            await asyncio.sleep(WRITE_EVERY_S)
            self._forget()
            view, armed = self._runtime.view, self._armed
            self._armed = view is not None and view.snapshot.armed
            if view is None:
                if armed:
                    await self._save(LOST)
                continue
            if view.snapshot.faults and not latched:
                self._why = "-".join(view.snapshot.faults)
                await asyncio.sleep(self._section.after_s)
                self._forget()
                await self._save(self._why)
            latched = bool(view.snapshot.faults)

    def _forget(self) -> None:
        """Drop messages that are too old for a fault's file."""
        kept_s = self._section.before_s + self._section.after_s + WRITE_EVERY_S
        self._waiting.forget(self._runtime.clock.now_ns() - round(kept_s * 1e9))

    async def _save(self, what: str) -> None:
        batch, self._why = self._waiting.take(), None
        try:
            path = await asyncio.to_thread(self._write_whole, batch, what)
        except OSError as error:
            self._fail(error, len(batch))
        else:
            self._recovered()
            _log.info("publish.%s: what led to the fault is in %s", self._name, path)

    def _write_whole(self, batch: list[Entry], what: str) -> str:
        """Write a whole file and return its path. Runs in the writing thread. Raises OSError."""
        with self._writing:
            return self._written(batch, what)

    def _written(self, batch: list[Entry], what: str) -> str:
        """Write a whole file and return its path. Raises OSError."""
        self._recording = self._folder.open(what)
        self._recording.add([*self._described(batch), *batch])
        recording, self._recording = self._recording, None
        recording.close()
        return str(recording.path)

    # -------------------------------------------------------------------------------------- both
    def _described(self, batch: list[Entry]) -> list[Entry]:
        """Return the messages that begin each file: the robot description, and with tf its fixed
        frames."""
        log_ns = batch[0].log_ns if batch else self._runtime.clock.now_ns()
        return [Entry(topic, kind, log_ns, message) for topic, kind, message in self._latched]

    def _finish(self) -> None:
        """Write what waits, and the index, at the end."""
        with self._writing:
            try:
                if self._section.mode == "fault":
                    self._finish_fault()
                elif self._recording is not None:
                    recording, self._recording = self._recording, None
                    recording.add(self._waiting.take())
                    recording.close()
            except OSError as error:
                _log.warning("publish.%s: %s", self._name, error)

    def _finish_fault(self) -> None:
        """Save the file of a fault whose time after it is not over, or of an end while the robot is
        armed. Raises OSError."""
        view = self._runtime.view
        armed = self._armed or (view is not None and view.snapshot.armed)
        why = self._why or (LOST if armed else None)
        if why is not None and len(self._waiting):
            self._forget()
            path = self._written(self._waiting.take(), why)
            _log.info("publish.%s: what led to the end is in %s", self._name, path)

    def _fail(self, error: OSError, lost: int) -> None:
        self._feed.dropped += lost
        if self._recording is not None:
            self._recording.abandon()
            self._recording = None
        if not self._failing:
            self._failing = True
            _log.warning("publish.%s: nothing is recorded: %s", self._name, error)

    def _recovered(self) -> None:
        if self._failing:
            self._failing = False
            _log.info("publish.%s: records again", self._name)
