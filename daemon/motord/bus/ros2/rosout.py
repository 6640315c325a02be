# SPDX-License-Identifier: Apache-2.0
"""Publishes warnings and errors of motord-bus, and the causes of the robot's faults, on /rosout,
the topic of all ROS 2 nodes' logs."""

from __future__ import annotations

import logging
import time
from types import SimpleNamespace

from motord.bus.log_listener import LogListener
from motord.bus.ros2.nodes import TopicPublisher

ROSOUT, LOG = "/rosout", "rcl_interfaces/msg/Log"
_LEVELS = ((logging.CRITICAL, 50), (logging.ERROR, 40))
"""Levels of Python's logging and of rcl_interfaces/Log; all lower levels count as warnings."""
_WARN, _ERROR = 30, 40


class Rosout:
    def __init__(self, node: str, publisher: TopicPublisher) -> None:
        """`node`: full name of the node in ROS."""
        self.log = LogListener(self._publish)
        self._name, self._publisher = node.strip("/").replace("/", "."), publisher
        self._why: tuple[str, ...] = ()

    def look(self, why: tuple[str, ...]) -> None:
        """Publish each new cause of a latched fault once, in the daemon's words."""
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
