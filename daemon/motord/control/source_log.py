# SPDX-License-Identifier: Apache-2.0
"""Logs what is wrong with the sources of commands: which are held, and which send too seldom for
their lease. Each is logged once."""

from __future__ import annotations

import logging

from motord.control.leases import HELD_SINCE, RELEASES, Leases

_log = logging.getLogger(__name__)


class SourceLog:
    """What was logged about the sources of one robot."""

    def __init__(self, leases: Leases) -> None:
        self._leases = leases
        self._held: frozenset[str] = frozenset()
        """Owners that were held at the last look."""
        self._sparse: set[int] = set()
        """Numbers of the leases that were reported."""

    def look(self) -> None:
        """Log what is new since the last look."""
        held = frozenset(one.owner for one in self._leases.held())
        if new := sorted(held - self._held):
            _log.warning("held: %s: %s. %s", ", ".join(new), HELD_SINCE, RELEASES)
        self._held = held
        sparse = self._leases.sparse()
        for number in sparse.keys() - self._sparse:
            _log.warning("%s", sparse[number])
        self._sparse = self._sparse & self._leases.numbers() | sparse.keys()
