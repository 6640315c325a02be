# SPDX-License-Identifier: Apache-2.0
"""Warnings and errors of motord-bus, and what led to the robot's faults, on /rosout: where ROS 2
has the log of every node."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterator
from types import SimpleNamespace

from motord.bus.inbox import Inbox
from motord.bus.ros2.nodes import TopicPublisher

ROSOUT, LOG = "/rosout", "rcl_interfaces/msg/Log"
WAITING_MAX = 100
_LEVELS = ((logging.CRITICAL, 50), (logging.ERROR, 40))
"""Ours and those of rcl_interfaces/Log; all else is a warning."""
_WARN, _ERROR = 30, 40


class Rosout(logging.Handler):
    """Records come from any thread; they are published in the event loop."""

    def __init__(self, node: str, publisher: TopicPublisher) -> None:
        """`node`: full name, as it is known in ROS."""
        super().__init__(logging.WARNING)
        self._name, self._publisher = node.strip("/").replace("/", "."), publisher
        self._waiting: Inbox[logging.LogRecord] = Inbox(WAITING_MAX, self._publish)
        self._why: tuple[str, ...] = ()

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Publish what is logged meanwhile."""
        self._waiting.open()
        logging.getLogger().addHandler(self)
        try:
            yield
        finally:
            logging.getLogger().removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """As logging.Handler.emit."""
        self._waiting.put(record)

    def look(self, why: tuple[str, ...]) -> None:
        """What has led to the faults that are latched: the daemon's own word, each once."""
        for text in why:
            if text not in self._why:
                self._publish_text(time.time_ns(), _ERROR, text, "", "", 0)
        self._why = why

    def _publish(self, record: logging.LogRecord) -> None:
        level = next((number for ours, number in _LEVELS if record.levelno >= ours), _WARN)
        stamp_ns, text = round(record.created * 1e9), record.getMessage()
        self._publish_text(
            stamp_ns, level, text, record.filename, record.funcName or "", record.lineno
        )

    def _publish_text(
        self, stamp_ns: int, level: int, text: str, file: str, function: str, line: int
    ) -> None:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        self._publisher.publish(
            SimpleNamespace(
                stamp=SimpleNamespace(sec=sec, nanosec=nanosec),
                level=level,
                name=self._name,
                msg=text,
                file=file,
                function=function,
                line=line,
            )
        )
