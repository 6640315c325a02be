# SPDX-License-Identifier: Apache-2.0
"""Waiting times between tries. Pure: the caller does the waiting."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class Backoff:
    """Waiting times that double from `first_s` up to `limit_s`."""

    first_s: float
    limit_s: float
    _next_s: float = field(init=False)

    def __post_init__(self) -> None:
        if not 0 < self.first_s <= self.limit_s < float("inf"):
            raise ValueError(f"first {self.first_s} s, limit {self.limit_s} s: 0 < first <= limit")
        self._next_s = self.first_s

    def next_s(self) -> float:
        """Return the time to wait before the next try. Each call doubles the following one."""
        wait_s = self._next_s
        self._next_s = min(2 * wait_s, self.limit_s)
        return wait_s

    def reset(self) -> None:
        """Begin again at `first_s`, after a success."""
        self._next_s = self.first_s
