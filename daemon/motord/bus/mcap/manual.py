# SPDX-License-Identifier: Apache-2.0
"""Recordings that a person starts and stops: mode "manual". Between them nothing is fed, kept or
written."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

from motord.bus.adapters import Adapter, RecorderState
from motord.bus.mcap.recorder import McapRecorder
from motord.config import McapPublish

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime


def recorder(name: str, section: McapPublish, runtime: Runtime) -> Adapter:
    """Create the adapter of a section, and register it with the runtime."""
    kind = ManualRecorder if section.mode == "manual" else McapRecorder
    made = runtime.recorders[name] = kind(name, section, runtime)
    return made


class ManualRecorder:
    """A recorder that can be started and stopped: motord.bus.adapters.Recorder."""

    def __init__(self, name: str, section: McapPublish, runtime: Runtime) -> None:
        self._name, self._section, self._runtime = name, section, runtime
        self._recorder: McapRecorder | None = None
        self._started = asyncio.Event()

    @property
    def state(self) -> RecorderState:
        """Implement `Recorder.state`."""
        recording = self._started.is_set()
        if self._recorder is None:
            return RecorderState(mode="manual", recording=recording)
        return replace(self._recorder.state, recording=recording)

    def start(self) -> None:
        """Begin a new file, unless it records already."""
        self._started.set()

    def stop(self) -> None:
        """Write what waits, and close the file."""
        self._started.clear()
        if self._recorder is not None:
            self._recorder.end()

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        while True:
            await self._started.wait()
            if not self._started.is_set():  # stopped before this task had its turn
                continue
            self._recorder = McapRecorder(self._name, self._section, self._runtime)
            try:
                await self._recorder.run()
            finally:
                self._recorder = None
                self._runtime.feeds.pop(self._name, None)
