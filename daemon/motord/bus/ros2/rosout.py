# SPDX-License-Identifier: Apache-2.0
"""Warnings and errors of motord-bus, and what led to the robot's faults, on /rosout: where ROS 2
has the log of every node."""

from __future__ import annotations

import logging
import time
from types import SimpleNamespace

from motord.bus.log_listener import LogListener
from motord.bus.ros2.nodes import TopicPublisher

ROSOUT, LOG = "/rosout", "rcl_interfaces/msg/Log"
_LEVELS = ((logging.CRITICAL, 50), (logging.ERROR, 40))
"""Ours and those of rcl_interfaces/Log; all else is a warning."""
_WARN, _ERROR = 30, 40


class Rosout:
    def __init__(self, node: str, publisher: TopicPublisher) -> None:
        """`node`: full name, as it is known in ROS."""
        self.log = LogListener(self._publish)
        self._name, self._publisher = node.strip("/").replace("/", "."), publisher
        self._why: tuple[str, ...] = ()

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
