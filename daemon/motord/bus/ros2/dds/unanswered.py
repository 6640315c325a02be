# SPDX-License-Identifier: Apache-2.0
"""Logs clients of motord's services whose middleware does not read the answers: each once, with
what to do. Otherwise a person at a command line would wait without knowing why."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from motord.base.rate_limited_log import AGAIN_S
from motord.bus.ros2.senders import unnamed

NAMED_WITHIN_S = 6.0
"""Time to wait for the name of a client's node, which appears in the graph after its endpoints.
After that time the client is logged without its name."""
_WAITING_MAX = 64
_REPORTED_MAX = 256
_IN_A_LINE = 4
_CYCLONE = b"\x01\x10"
_VENDORS = {b"\x01\x01": "RTI Connext", b"\x01\x0f": "Fast DDS"}
"""Vendors by the first two bytes of an endpoint's id (DDSI-RTPS, 9.3.1.1)."""

_log = logging.getLogger(__name__)


def answered(gid: bytes) -> bool:
    """Return whether the endpoint's middleware puts the client into the message, as Cyclone DDS
    does."""
    return gid[:2] == _CYCLONE


def middleware(gid: bytes) -> str:
    """Return the name of an endpoint's middleware, by its vendor."""
    return _VENDORS.get(gid[:2], f"DDS of vendor {gid[:2].hex('.')}")


class Unanswered:
    def __init__(self, node_of: Callable[[bytes], str | None]) -> None:
        """`node_of` returns the name of an endpoint's node; None if it is not known yet."""
        self._node_of = node_of
        self._waiting: dict[tuple[bytes, str], float] = {}
        """When each client arrived that is not logged yet, by its endpoint and the service."""
        self._reported: set[tuple[str, str]] = set()
        self._due_s = 0.0
        self._more = 0

    def add(self, gid: bytes, service: str, now_s: float | None = None) -> None:
        """Note a client of a service."""
        if len(self._waiting) < _WAITING_MAX:
            self._waiting.setdefault((gid, service), _now_s(now_s))
        else:
            self._more += 1

    def say(self, now_s: float | None = None) -> None:
        """Log the clients whose name is known, or has not become known in time."""
        now_s = _now_s(now_s)
        if now_s < self._due_s:
            return
        found: dict[str, list[str]] = {}
        for (gid, service), came_s in list(self._waiting.items()):
            node = self._node_of(gid)
            if node is None and now_s - came_s < NAMED_WITHIN_S:
                continue
            client = f"{node or unnamed(gid)} ({middleware(gid)})"
            if (client, service) not in self._reported:
                if client not in found and len(found) == _IN_A_LINE:
                    continue
                found.setdefault(client, []).append(service)
                self._remember(client, service)
            del self._waiting[gid, service]
        if found:
            self._due_s = now_s + AGAIN_S
            self._report(found)

    def _remember(self, client: str, service: str) -> None:
        if len(self._reported) == _REPORTED_MAX:
            self._reported.clear()
        self._reported.add((client, service))

    def _report(self, found: dict[str, list[str]]) -> None:
        clients = "; ".join(f"{client} calls {_few(names)}" for client, names in found.items())
        more = f" ({self._more} more)" if self._more else ""
        self._more = 0
        _log.warning(
            "clients of services whose middleware does not read our answers: %s%s: run them with"
            " RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or run the bridge (ros2-rclpy); to stop the"
            " robot, stop and estop are topics as well",
            clients,
            more,
        )


def _few(names: list[str]) -> str:
    shown = ", ".join(names[:_IN_A_LINE])
    return f"{shown} and {len(names) - _IN_A_LINE} more" if len(names) > _IN_A_LINE else shown


def _now_s(now_s: float | None) -> float:
    return time.monotonic() if now_s is None else now_s
