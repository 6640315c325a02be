# SPDX-License-Identifier: Apache-2.0
"""Warnings and errors of this process, for an adapter that publishes them."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator

from motord.bus.inbox import Inbox

WAITING_MAX = 100


class LogListener(logging.Handler):
    """Records come from any thread; `take` is called in the event loop, with the newest ones."""

    def __init__(self, take: Callable[[logging.LogRecord], None]) -> None:
        super().__init__(logging.WARNING)
        self._waiting: Inbox[logging.LogRecord] = Inbox(WAITING_MAX, take)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Take what is logged meanwhile."""
        self._waiting.open()
        logging.getLogger().addHandler(self)
        try:
            yield
        finally:
            logging.getLogger().removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """As logging.Handler.emit."""
        self._waiting.put(record)
