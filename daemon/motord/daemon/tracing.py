# SPDX-License-Identifier: Apache-2.0
"""The method `trace` of the local socket. A line is traced until KEPT_ON_S after the last call."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from itertools import islice
from typing import Any

from motord.local_socket.server import INVALID_PARAMS, Refused, RpcError
from motord_hal.base.nearest import did_you_mean
from motord_hal.fieldbus.ports import Line

KEPT_ON_S = 2.0
ENTRIES_MAX = 128
"""Most entries in one answer."""


class Tracing:
    """Tracing of all lines of the daemon."""

    def __init__(self, lines: Sequence[Line]) -> None:
        self._lines = {line.spec.name: line for line in lines}
        self._off: dict[str, asyncio.TimerHandle] = {}

    def read(self, name: str, after: int | None) -> dict[str, Any]:
        """Return entries with numbers above `after`; None: from now on. Raises RpcError."""
        line = self._lines.get(name)
        if line is None:
            known = ", ".join(self._lines)
            hint = did_you_mean(name, self._lines)
            raise RpcError(f"there is no line {name!r}{hint}; there are: {known}", INVALID_PARAMS)
        trace = line.trace
        if trace is None:
            raise Refused(f"{name} has pins and exchanges nothing: motord top shows its duties")
        if name in self._off:
            self._off[name].cancel()
        trace.switch(on=True)
        self._off[name] = asyncio.get_running_loop().call_later(KEPT_ON_S, self._switch_off, name)
        start = trace.newest if after is None else after
        return {
            "newest": trace.newest,
            "kind": line.spec.kind,
            "port": line.spec.port,
            "engine": line.engine,
            "entries": [
                {
                    "number": entry.number,
                    "stamp_ns": entry.stamp_ns,
                    "outward": entry.outward,
                    "data": entry.data.hex(),
                }
                for entry in islice(trace.after(start), ENTRIES_MAX)
            ],
        }

    def _switch_off(self, name: str) -> None:
        del self._off[name]
        trace = self._lines[name].trace
        if trace is not None:
            trace.switch(on=False)
