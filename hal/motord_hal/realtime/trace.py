# SPDX-License-Identifier: Apache-2.0
"""The trace of a line whose thread is in C (csrc/api/api_trace.h)."""

from __future__ import annotations

from collections.abc import Iterator

from _motord_rt import ffi, lib

from motord_hal.base.errors import HalError
from motord_hal.fieldbus.trace import TraceEntry


class RtTrace:
    """Implements `fieldbus.trace.Trace`: the thread writes the entries, asyncio reads them."""

    def __init__(self, line: int) -> None:
        self._line = line
        self._entry = ffi.new("trace_entry *")

    def switch(self, *, on: bool) -> None:
        if lib.line_trace_switch(self._line, on) != 0:
            raise HalError(f"there is no line {self._line} to trace")

    @property
    def newest(self) -> int:
        return int(lib.line_trace_newest(self._line))

    def after(self, number: int) -> Iterator[TraceEntry]:
        entry = self._entry
        for one in range(max(number + 1, self.newest - lib.TRACE_ENTRIES + 1), self.newest + 1):
            if lib.line_trace_read(self._line, one, entry):
                data = bytes(ffi.buffer(entry.data)[0 : entry.bytes])
                yield TraceEntry(one, entry.stamp_ns, entry.outward != 0, data)
