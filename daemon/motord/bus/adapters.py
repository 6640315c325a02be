# SPDX-License-Identifier: Apache-2.0
"""Finds the class for a kind of bus, in the second process."""

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
"""Groups of entry points in which other packages may offer kinds of their own."""


class Adapter(Protocol):
    """An adapter of a bus. It is created with the section's name, the section and the Runtime. What
    it does not take from its feed in time is lost."""

    async def run(self) -> None:
        """Run until cancelled. Log a failure outside motord once, and go on. An adapter that raises
        is run again (motord.bus.guard)."""
        ...


@dataclass(frozen=True, slots=True)
class RecorderState:
    """State of a recorder."""

    mode: str
    """Mode of the recorder: see `McapPublish.mode`."""
    recording: bool
    """Whether it records; False: it waits for its start."""
    file: str | None = None
    """Name of the file that it writes now; None: no file is open."""
    since_wall_time_s: float | None = None
    """Time at which that file was begun."""
    failing: bool = False
    """Whether it fails to write; the log names the reason."""


class Recorder(Protocol):
    """Records to files in the folder of its section."""

    @property
    def state(self) -> RecorderState: ...

    def start(self) -> None:
        """Begin a file, unless it records already. Raises NotTaken if its mode is not "manual"."""
        ...

    def stop(self) -> None:
        """End the file. Raises NotTaken if its mode is not "manual"."""
        ...


def find(where: str, kind: str, table: Mapping[str, str], group: str) -> Any:
    """Return the class or function that creates an adapter of that kind. Raises LookupError for a
    kind that no package offers, and ImportError if a package that it needs is missing."""
    if kind in table:
        module, _, attribute = table[kind].partition(":")
        return getattr(import_module(module), attribute)
    offered = {point.name: point for point in entry_points(group=group)}
    if kind not in offered:
        known = ", ".join([*table, *offered])
        raise LookupError(f'{where}: no installed package offers kind "{kind}"; there are: {known}')
    return offered[kind].load()
