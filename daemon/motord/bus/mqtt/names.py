# SPDX-License-Identifier: Apache-2.0
"""Names of topics on an MQTT broker, in one of two schemes.

plain      PREFIX/odom, PREFIX/cmd_vel, PREFIX/call, PREFIX/answer; retained PREFIX/description, and
           PREFIX/status, which is online or offline
sparkplug  NAMESPACE/GROUP/DDATA/ROBOT/odom, .../DCMD/ROBOT/cmd_vel, .../NCMD/ROBOT (calls),
           .../NDATA/ROBOT (answers); retained .../NBIRTH/ROBOT, .../DBIRTH/ROBOT/odom,
           .../NDEATH/ROBOT

The second has Sparkplug's names and its birth and death, not its payloads (Eclipse Sparkplug 3.0,
chapters 4 and 6): those stay JSON or CBOR. A robot is an edge node, a topic is a device of it.
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
"""What is received beside commands."""
Encode = Callable[[Any], bytes]
Sent = tuple[str, bytes]
"""A topic, and what is retained there."""


class Names(Protocol):
    answer: str
    """Where calls are answered."""

    def data(self, topic: str) -> str:
        """The topic of its messages."""
        ...

    def received(self, what: str) -> str:
        """Where commands of that topic, or calls, are received."""
        ...

    def births(self, description: Mapping[str, Any]) -> Iterator[Sent]:
        """The messages that announce us, and our topics."""
        ...

    def death(self) -> Sent:
        """The message that we are gone. It is set up at the beginning of each connection, and the
        broker publishes it in our place."""
        ...


class Plain:
    def __init__(self, prefix: str, encode: Encode) -> None:
        self._prefix = prefix
        self._encode = encode
        self.answer = self.data("answer")

    def data(self, topic: str) -> str:
        """As Names."""
        return f"{self._prefix}/{topic}"

    received = data

    def births(self, description: Mapping[str, Any]) -> Iterator[Sent]:
        """As Names."""
        yield self.data("description"), self._encode(description)
        yield self.data("status"), ONLINE

    def death(self) -> Sent:
        """As Names."""
        return self.data("status"), OFFLINE


class Sparkplug:
    def __init__(self, namespace: str, group: str, robot: str, encode: Encode) -> None:
        self._head = f"{namespace}/{group}"
        self._robot = robot
        self._encode = encode
        self._session_ms = 0
        self.answer = f"{self._head}/NDATA/{robot}"

    def data(self, topic: str) -> str:
        """As Names."""
        return f"{self._head}/DDATA/{self._robot}/{topic}"

    def received(self, what: str) -> str:
        """As Names."""
        kind, device = ("NCMD", "") if what == CALL else ("DCMD", f"/{what}")
        return f"{self._head}/{kind}/{self._robot}{device}"

    def births(self, description: Mapping[str, Any]) -> Iterator[Sent]:
        """As Names; `bdSeq` pairs them with their death certificate."""
        session = {"timestamp": _now_ms(), "bdSeq": self._session_ms}
        yield f"{self._head}/NBIRTH/{self._robot}", self._encode({**session, **description})
        for topic, about in description["topics"].items():
            birth = {"timestamp": _now_ms(), **about}
            yield f"{self._head}/DBIRTH/{self._robot}/{topic}", self._encode(birth)

    def death(self) -> Sent:
        """As Names. Retained as the birth is: of the two that have one `bdSeq`, it is the later."""
        self._session_ms = max(_now_ms(), self._session_ms + 1)
        return f"{self._head}/NDEATH/{self._robot}", self._encode({"bdSeq": self._session_ms})


def names_of(section: MqttBroker, robot: str, encode: Encode) -> Names:
    """In the section's scheme."""
    if section.topic_scheme == "sparkplug":
        namespace, group = section.topic_prefix or SPARKPLUG, section.group or GROUP
        return Sparkplug(namespace, group, robot, encode)
    return Plain(section.topic_prefix or f"motord/{robot}", encode)


def _now_ms() -> int:
    """Since 1970, as Sparkplug has it."""
    return time.time_ns() // 1_000_000
