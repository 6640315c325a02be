# SPDX-License-Identifier: Apache-2.0
"""Publishes topics as a ROS 2 node, and the robot description with its fixed frames for programs
that display the robot."""

from __future__ import annotations

import asyncio
import logging
from types import SimpleNamespace
from typing import TYPE_CHECKING

from motord.bus.messages.forms import as_cdr
from motord.bus.messages.topics import TOPICS
from motord.bus.ros2.names import full_name
from motord.bus.ros2.nodes import TopicPublisher, node_of
from motord.bus.ros2.quality import offered
from motord.bus.ros2.rosout import LOG, ROSOUT, Rosout
from motord.bus.ros2.static_frames import STATIC, static_transforms
from motord.bus.ros2.urdf import DESCRIPTION, STRING, urdf
from motord.config import Ros2Publish, RosTopics, ZenohPublish
from motord_hal.base import bounded
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

URDF_BYTES_MAX = 1 << 20
_ABSOLUTE = ("tf", STATIC)
"""Topics to which tf2 subscribes without a namespace."""

_LOOK_EVERY_S = 0.2

_log = logging.getLogger(__name__)


def robot_topic(topic: str, section: RosTopics) -> str:
    """Return the ROS name of a topic. All robots publish diagnostics on one topic (REP-107)."""
    absolute = topic == "diagnostics" or (topic in _ABSOLUTE and not section.namespaced_tf)
    return f"/{topic}" if absolute else topic


class Ros2Publisher:
    def __init__(self, name: str, section: Ros2Publish | ZenohPublish, runtime: Runtime) -> None:
        """Raises DdsError, and OSError and ValueError for a description that cannot be read."""
        self._description = _description(section, runtime)
        self._node = node_of(runtime, section)
        self._prefix = section.prefix_of_frames()
        body = runtime.body.with_frames(self._prefix)
        self._feed = runtime.feed(name, section.rates_hz(), as_cdr, body)
        self._publishers: dict[str, TopicPublisher] = {
            topic: self._node.publisher(
                robot_topic(topic, section), TOPICS[topic].type_name, offered(topic)
            )
            for topic in section.topics
        }
        self._describing = self._node.publisher(DESCRIPTION, STRING, offered(DESCRIPTION))
        log = self._node.publisher(ROSOUT, LOG, offered(ROSOUT))
        self._rosout = Rosout(full_name(section.namespace, section.node_name, "~/")[:-1], log)
        self._runtime = runtime
        self._static: TopicPublisher | None = None
        if "tf" in section.topics:
            self._static = self._node.publisher(
                robot_topic(STATIC, section), TOPICS["tf"].type_name, offered(STATIC)
            )

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        async with TaskGroup() as tasks:
            tasks.create_task(self._node.run())
            tasks.create_task(self._publish())
            tasks.create_task(self._log())

    async def _publish(self) -> None:
        self._describing.publish(SimpleNamespace(data=self._description))
        self._send_frames()
        async for topic, message in self._feed:
            self._publishers[topic.name].publish(message)

    async def _log(self) -> None:
        with self._rosout.log.listening():
            while True:
                view = self._runtime.view
                self._rosout.look(view.why() if view is not None else ())
                await asyncio.sleep(_LOOK_EVERY_S)

    def _send_frames(self) -> None:
        if self._static is None:
            return
        try:
            now_ns = self._runtime.clock.now_ns()
            frames = static_transforms(self._description, now_ns, self._prefix)
        except ValueError as error:
            _log.warning("no tf_static: %s", error)
        else:
            self._static.publish(frames)


def _description(section: RosTopics, runtime: Runtime) -> str:
    if section.urdf_file is None:
        return urdf(runtime.robot)
    path = runtime.beside_robot_file(section.urdf_file)
    if path.stat().st_size > URDF_BYTES_MAX:
        raise ValueError(f"{path}: more than {URDF_BYTES_MAX} bytes are no robot description")
    return bounded.read(path, URDF_BYTES_MAX).decode()
