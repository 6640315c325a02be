# SPDX-License-Identifier: Apache-2.0
"""Names of topics on an MQTT broker, in one of two schemes.

plain      PREFIX/odom, PREFIX/cmd_vel, PREFIX/call, PREFIX/answer; retained PREFIX/description, and
           PREFIX/status, which is online or offline
sparkplug  NAMESPACE/GROUP/DDATA/ROBOT/odom, .../DCMD/ROBOT/cmd_vel, .../NCMD/ROBOT (calls),
           .../NDATA/ROBOT (answers); retained .../NBIRTH/ROBOT, .../DBIRTH/ROBOT/odom,
           .../NDEATH/ROBOT

sparkplug has the names and the birth and death messages of Eclipse Sparkplug 3.0, chapters 4 and
6, but not its payloads: those stay JSON or CBOR. The robot is an edge node, each topic a device.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from motord.config import MqttBroker

ONLINE, OFFLINE = b"online", b"offline"
SPARKPLUG = "spBv1.0"
GROUP = "motord"
CALL = "call"
"""Stands for the topic of calls in `Names.received`."""
Encode = Callable[[Any], bytes]
Sent = tuple[str, bytes]
"""A topic and the message that is retained on it."""


class Names(Protocol):
    answer: str
    """Topic of the answers to calls."""

    def data(self, topic: str) -> str:
        """Return the MQTT topic on which messages of `topic` are published."""
        ...

    def received(self, what: str) -> str:
        """Return the MQTT topic on which `what` is received: a topic of commands, or CALL."""
        ...

    def births(self, description: Mapping[str, Any]) -> Iterator[Sent]:
        """Yield the messages that announce the robot and its topics."""
        ...

    def death(self) -> Sent:
        """Return the message that the robot is gone. The client registers it when a connection
        begins, and the broker publishes it when the connection is lost."""
        ...


class Plain:
    def __init__(self, prefix: str, encode: Encode) -> None:
        self._prefix = prefix
        self._encode = encode
        self.answer = self.data("answer")

    def data(self, topic: str) -> str:
        """Implement `Names.data`."""
        return f"{self._prefix}/{topic}"

    received = data

    def births(self, description: Mapping[str, Any]) -> Iterator[Sent]:
        """Implement `Names.births`."""
        yield self.data("description"), self._encode(description)
        yield self.data("status"), ONLINE

    def death(self) -> Sent:
        """Implement `Names.death`."""
        return self.data("status"), OFFLINE


class Sparkplug:
    def __init__(self, namespace: str, group: str, robot: str, encode: Encode) -> None:
        self._head = f"{namespace}/{group}"
        self._robot = robot
        self._encode = encode
        self._session_ms = 0
        self.answer = f"{self._head}/NDATA/{robot}"

    def data(self, topic: str) -> str:
        """Implement `Names.data`."""
        return f"{self._head}/DDATA/{self._robot}/{topic}"

    def received(self, what: str) -> str:
        """Implement `Names.received`."""
        kind, device = ("NCMD", "") if what == CALL else ("DCMD", f"/{what}")
        return f"{self._head}/{kind}/{self._robot}{device}"

    def births(self, description: Mapping[str, Any]) -> Iterator[Sent]:
        """Implement `Names.births`; `bdSeq` pairs the birth with its death certificate."""
        session = {"timestamp": _now_ms(), "bdSeq": self._session_ms}
        yield f"{self._head}/NBIRTH/{self._robot}", self._encode({**session, **description})
        for topic, about in description["topics"].items():
            birth = {"timestamp": _now_ms(), **about}
            yield f"{self._head}/DBIRTH/{self._robot}/{topic}", self._encode(birth)

    def death(self) -> Sent:
        """Implement `Names.death`. It is retained, as the birth is: of two with the same `bdSeq`,
        the death is the later."""
        self._session_ms = max(_now_ms(), self._session_ms + 1)
        return f"{self._head}/NDEATH/{self._robot}", self._encode({"bdSeq": self._session_ms})


def names_of(section: MqttBroker, robot: str, encode: Encode) -> Names:
    """Return the names in the topic scheme of the section."""
    if section.topic_scheme == "sparkplug":
        namespace, group = section.topic_prefix or SPARKPLUG, section.group or GROUP
        return Sparkplug(namespace, group, robot, encode)
    return Plain(section.topic_prefix or f"motord/{robot}", encode)


def _now_ms() -> int:
    """Return the time since 1970, as Sparkplug requires it."""
    return time.time_ns() // 1_000_000
