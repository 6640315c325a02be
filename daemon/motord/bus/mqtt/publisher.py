# SPDX-License-Identifier: Apache-2.0
"""Publishes topics on an MQTT broker. Retained messages (names.py) show which topics there are and
whether the robot is connected; the broker itself publishes that the robot is gone."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import aiomqtt

from motord.api.snapshot import SNAPSHOT_VERSION
from motord.bus.messages.topics import TOPICS
from motord.bus.mqtt.connection import MqttConnection, taken
from motord.config import MqttPublish

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime


class MqttPublisher:
    def __init__(self, name: str, section: MqttPublish, runtime: Runtime) -> None:
        """Raises the errors of `MqttConnection`."""
        self._connection = MqttConnection(f"publish.{name}", section, runtime)
        self._qos = section.qos
        self._feed = runtime.feed(name, section.rates_hz(), self._connection.form)
        self._description = _description(section, runtime)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        await self._connection.keep(self._use, self._will)

    def _will(self) -> aiomqtt.Will:
        self._death = self._connection.names.death()
        return aiomqtt.Will(*self._death, qos=1, retain=True)

    async def _use(self, client: aiomqtt.Client) -> None:
        names = self._connection.names
        for name, message in names.births(self._description):
            await taken(client.publish(name, message, 1, retain=True))
        try:
            async for topic, message in self._feed:
                await taken(client.publish(names.data(topic.name), message, self._qos))
        finally:
            with contextlib.suppress(aiomqtt.MqttError):
                await client.publish(*self._death, 0, retain=True)


def _description(section: MqttPublish, runtime: Runtime) -> dict[str, Any]:
    body, base = runtime.body, runtime.robot.base
    return {
        "robot": body.robot,
        "version": SNAPSHOT_VERSION,
        "joints": list(body.joints),
        "frames": {"odom": body.odom_frame, "base": body.base_frame},
        "base": dict(vars(base)),
        "topics": {
            name: {"type": TOPICS[name].type_name, "rate_hz": rate_hz}
            for name, rate_hz in section.rates_hz().items()
        },
    }
