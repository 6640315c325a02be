# SPDX-License-Identifier: Apache-2.0
"""Logs new endpoints of other nodes in the domain whose type differs from motord's, and new clients
of services that get no answer."""

from __future__ import annotations

import asyncio
import logging
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant

from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.ros2.dds.other_types import Side, type_conflict
from motord.bus.ros2.dds.unanswered import Unanswered, answered

_LOOK_AT_MOST = 64

_log = logging.getLogger(__name__)


def client_of(qos: Any) -> bytes | None:
    """Return `clientid` from an endpoint's user data; None if there is no such entry.
    rmw_cyclonedds gives it to every client of a service."""
    for policy in qos:
        if getattr(policy, "__scope__", "") == "Userdata":
            for pair in policy.data.split(b";"):
                key, _, value = pair.partition(b"=")
                if key == b"clientid":
                    return bytes(value)
    return None


class Discovered:
    """Endpoints that have appeared in the domain since the last call of `look`."""

    def __init__(
        self,
        participant: DomainParticipant,
        services: Mapping[str, str],
        node_of: Callable[[bytes], str | None],
    ) -> None:
        """`services`: names of services by their request topics. `node_of` returns the name of an
        endpoint's node, or None."""
        self._services = services
        self._unanswered = Unanswered(node_of)
        self._voices: defaultdict[str, RateLimitedLog] = defaultdict(lambda: RateLimitedLog(_log))
        """Logs by topic of this node, which limits their number."""
        self._readers: dict[Side, Any] = {
            "writer": BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
            "reader": BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
        }

    async def look(self, read: Mapping[str, str], written: Mapping[str, str]) -> None:
        """Look at the new endpoints. `read` and `written`: types by topic of this node. Each
        endpoint takes a turn of the event loop of its own: the binding makes some forty calls for
        it, and when other threads need Python's lock each of these calls waits for it."""
        sides: tuple[tuple[Side, Mapping[str, str]], ...] = (("writer", read), ("reader", written))
        for side, ours in sides:
            for _ in range(_LOOK_AT_MOST):
                if not self._look_at_next(side, ours):
                    break
                await asyncio.sleep(0)
        self._unanswered.say()

    def _look_at_next(self, side: Side, ours: Mapping[str, str]) -> bool:
        """Look at the next new endpoint; return False if no endpoint is left."""
        try:
            found = self._readers[side].take(N=1)
        except DDSException as error:
            self._voices[side].say(f"DDS does not report {side}s: {error.msg}")
            return False
        for one in found:
            topic = one.topic_name
            if topic in ours and (
                conflict := type_conflict(topic, side, ours[topic], one.type_name)
            ):
                self._voices[topic].say(conflict)
            elif side == "writer" and topic in self._services:
                gid = one.key.bytes
                if client_of(one.qos) is None and not answered(gid):
                    self._unanswered.add(gid, self._services[topic])
        return bool(found)
