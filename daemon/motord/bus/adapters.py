# SPDX-License-Identifier: Apache-2.0
"""From a bus's kind to the class that moves its bytes, in the second process."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any, Protocol

# Tables of strings: a robot loads only the buses that it has.
PUBLISHERS = MappingProxyType(
    {
        "foxglove": "motord.bus.foxglove.adapter:FoxgloveAdapter",
        "mcap": "motord.bus.mcap.recorder:McapRecorder",
        "mqtt": "motord.bus.mqtt.publisher:MqttPublisher",
        "ros2": "motord.bus.ros2.publisher:Ros2Publisher",
        "ros2-zenoh": "motord.bus.ros2.publisher:Ros2Publisher",
        "rosbridge": "motord.bus.rosbridge.adapter:RosbridgeAdapter",
        "prometheus": "motord.bus.prometheus.server:PrometheusServer",
        "web": "motord.bus.web.adapter:WebAdapter",
    }
)
INPUTS = MappingProxyType(
    {
        "foxglove": "motord.bus.foxglove.adapter:FoxgloveAdapter",
        "joystick": "motord.bus.joystick.device:Joystick",
        "mqtt": "motord.bus.mqtt.commands:MqttCommands",
        "ros2": "motord.bus.ros2.commands:Ros2Commands",
        "ros2-zenoh": "motord.bus.ros2.commands:Ros2Commands",
        "rosbridge": "motord.bus.rosbridge.adapter:RosbridgeAdapter",
        "web": "motord.bus.web.adapter:WebAdapter",
    }
)
PUBLISHER_POINTS = "motord.publishers"
INPUT_POINTS = "motord.inputs"
"""Groups in which other packages may offer kinds of their own."""


class Adapter(Protocol):
    """Made of the section's name, the section and the Runtime. What it does not take in time of its
    feed is lost."""

    async def run(self) -> None:
        """Until cancelled; the world's faults are logged once and survived. One that raises is run
        again (motord.bus.guard)."""
        ...


def find(where: str, kind: str, table: Mapping[str, str], group: str) -> Any:
    """What makes an adapter of that kind. Raises LookupError for a kind that no package offers, and
    ImportError where a package that it needs is missing."""
    if kind in table:
        module, _, attribute = table[kind].partition(":")
        return getattr(import_module(module), attribute)
    offered = {point.name: point for point in entry_points(group=group)}
    if kind not in offered:
        known = ", ".join([*table, *offered])
        raise LookupError(f'{where}: no installed package offers kind "{kind}"; there are: {known}')
    return offered[kind].load()
