# SPDX-License-Identifier: Apache-2.0
"""From a bus's kind to the class that moves its bytes, in the second process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Any, Protocol

# Tables of strings: a robot loads only the buses that it has.
PUBLISHERS = MappingProxyType(
    {
        "foxglove": "motord.bus.foxglove.adapter:FoxgloveAdapter",
        "mcap": "motord.bus.mcap.manual:recorder",
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
        """Runs until cancelled. It logs a failure outside motord once and goes on. An adapter that
        raises is run again (motord.bus.guard)."""
        ...


@dataclass(frozen=True, slots=True)
class RecorderState:
    """What a recorder does now."""

    mode: str
    """As McapPublish.mode."""
    recording: bool
    """False: it waits for its start."""
    file: str | None = None
    """Name of the file that it writes; None: it writes none."""
    since_wall_time_s: float | None = None
    """When that file was begun."""
    failing: bool = False
    """It cannot write: the log names the reason."""


class Recorder(Protocol):
    """Records to files in the folder of its section."""

    @property
    def state(self) -> RecorderState: ...

    def start(self) -> None:
        """Begin a file, unless it records. Raises NotTaken: it is not of mode "manual"."""
        ...

    def stop(self) -> None:
        """End the file. Raises NotTaken: it is not of mode "manual"."""
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
