# SPDX-License-Identifier: Apache-2.0
"""Topics as a ROS 2 node has them, and the robot's description for who shows it, with the frames in
it that never move."""

from __future__ import annotations

import asyncio
import logging
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING

from motord.bus.messages import wall_time
from motord.bus.ros2.direct import encoder
from motord.bus.ros2.nodes import Teller, node_of
from motord.bus.ros2.quality import offered
from motord.bus.ros2.static_frames import STATIC, static_transforms
from motord.bus.ros2.urdf import DESCRIPTION, STRING, urdf
from motord.bus.topics import TOPICS
from motord.config import Ros2Publish, RosTopics, ZenohPublish

if TYPE_CHECKING:
    from motord.bus.station import Station

URDF_BYTES_MAX = 1 << 20
_NAMES = {"diagnostics": "/diagnostics"}
"""Of all robots together: REP-107."""

_log = logging.getLogger(__name__)


class Ros2Publisher:
    def __init__(self, name: str, section: Ros2Publish | ZenohPublish, station: Station) -> None:
        """Raises DdsError, and OSError and ValueError for a description that cannot be read."""
        self._description = _description(section, station)
        self._node = node_of(station, section)
        self._feed = station.feed(name, section.rates_hz(), encoder)
        self._publishers: dict[str, Teller] = {
            topic: self._node.publisher(
                _NAMES.get(topic, topic), TOPICS[topic].type_name, offered(topic)
            )
            for topic in section.topics
        }
        self._describing = self._node.publisher(DESCRIPTION, STRING, offered(DESCRIPTION))
        self._static: Teller | None = None
        if "tf" in section.topics:
            self._static = self._node.publisher(STATIC, TOPICS["tf"].type_name, offered(STATIC))

    async def run(self) -> None:
        """As Adapter.run."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._node.run())
            tasks.create_task(self._publish())

    async def _publish(self) -> None:
        self._describing.publish(SimpleNamespace(data=self._description))
        self._tell_frames()
        async for sample in self._feed:
            self._publishers[sample.topic.name].publish(sample.message)

    def _tell_frames(self) -> None:
        if self._static is None:
            return
        try:
            frames = static_transforms(self._description, wall_time(time.time_ns(), 0))
        except ValueError as error:
            _log.warning("no tf_static: %s", error)
        else:
            self._static.publish(frames)


def _description(section: RosTopics, station: Station) -> str:
    if section.urdf_file is None:
        return urdf(station.robot)
    path = station.beside_robot_file(section.urdf_file)
    if path.stat().st_size > URDF_BYTES_MAX:
        raise ValueError(f"{path}: more than {URDF_BYTES_MAX} bytes are no robot description")
    return path.read_text(encoding="utf-8")
