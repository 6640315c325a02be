# SPDX-License-Identifier: Apache-2.0
"""Names of the senders of commands on a topic, and detection of senders that command against each
other."""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from contextvars import ContextVar
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

SENDERS_MAX = 32
REPORTED_S = 5.0
"""Time for which a conflict is reported after the last command against another sender."""
_SMOOTH = 8.0
_PARTICIPANTS_MAX, _NAME_CHARS_MAX = 512, 100

_log = logging.getLogger(__name__)

asker: ContextVar[str] = ContextVar("asker", default="")
"""Name of the client whose request a service answers now."""


def unnamed(gid: bytes) -> str:
    """Return a name for a sender whose node the graph does not contain."""
    return f"endpoint {gid.hex()}" if any(gid) else "an endpoint that has gone"


class Graph:
    """Node names by endpoint, from ros_discovery_info."""

    def __init__(self) -> None:
        self._members: OrderedDict[bytes, dict[bytes, str]] = OrderedDict()

    def learn(self, info: SimpleNamespace) -> None:
        """Take all nodes of one participant from a decoded ParticipantEntitiesInfo."""
        participant = _gid(info.gid)
        self._members[participant] = {
            _gid(gid): _printable(f"{node.node_namespace.rstrip('/')}/{node.node_name}")
            for node in info.node_entities_info_seq
            for gid in (*node.writer_gid_seq, *node.reader_gid_seq)
        }
        self._members.move_to_end(participant)
        if len(self._members) > _PARTICIPANTS_MAX:
            self._members.popitem(last=False)

    def node(self, gid: bytes) -> str | None:
        """Return the name of the node that has this endpoint; None if no such node is known."""
        return next((own[gid] for own in self._members.values() if gid in own), None)

    def name(self, gid: bytes) -> str:
        """Return the name of the node that has this endpoint, or a name for the endpoint itself if
        no such node is known."""
        return self.node(gid) or unnamed(gid)


def _printable(name: str) -> str:
    """Return a name fit for one line of the log: an unknown program may choose any text as its
    name."""
    return "".join(one if one.isprintable() else "?" for one in name[:_NAME_CHARS_MAX])


def _gid(raw: SimpleNamespace) -> bytes:
    return bytes(raw.data)[:16]


@dataclass(slots=True)
class _Sender:
    command: tuple[float, ...]
    last_s: float
    interval_s: float = 0.0
    against_s: float = -REPORTED_S
    """Time of its last command against another sender."""


class Contest:
    """Detects senders of one topic that command against each other: one sends again although
    another has meanwhile sent a different command that is still in force."""

    def __init__(self, where: str, alive_s: float) -> None:
        """`alive_s`: how long a command is in force."""
        self._where, self._alive_s = where, alive_s
        self._senders: OrderedDict[str, _Sender] = OrderedDict()
        self._reported: set[frozenset[str]] = set()

    def received(self, name: str, command: tuple[float, ...], now_s: float | None = None) -> None:
        """Note a command that was taken."""
        now_s = time.monotonic() if now_s is None else now_s
        me = self._senders.get(name)
        if me is None or now_s - me.last_s > self._alive_s:
            self._senders[name] = _Sender(command, now_s)
            self._senders.move_to_end(name)
            if len(self._senders) > SENDERS_MAX:
                self._senders.popitem(last=False)
            return
        interval_s = now_s - me.last_s
        me.interval_s += (interval_s - me.interval_s) / (_SMOOTH if me.interval_s else 1.0)
        for other_name, other in self._senders.items():
            if (
                other is not me
                and other.last_s >= me.last_s
                and now_s - other.last_s <= self._alive_s
                and other.command != command
            ):
                me.against_s = other.against_s = now_s
                self._say(frozenset((name, other_name)), now_s)
        me.command, me.last_s = command, now_s

    def report(self, now_s: float | None = None) -> list[dict[str, Any]]:
        """Return the senders that command against each other, with their rates in Hz."""
        now_s = time.monotonic() if now_s is None else now_s
        return [
            {"from": name, "rate_hz": round(1.0 / one.interval_s, 1) if one.interval_s else 0.0}
            for name, one in self._senders.items()
            if now_s - one.against_s < REPORTED_S
        ]

    def _say(self, names: frozenset[str], now_s: float) -> None:
        """Log each pair of senders once."""
        both = [row for row in self.report(now_s) if row["from"] in names]
        if names in self._reported or not all(row["rate_hz"] for row in both):
            return
        if len(self._reported) == SENDERS_MAX:
            self._reported.clear()
        self._reported.add(names)
        _log.warning(
            "%s: %s command against each other, and the newest command counts: end one of them, or "
            "put twist_mux before it",
            self._where,
            " and ".join(f"{row['from']} ({row['rate_hz']:g} Hz)" for row in both),
        )
