# SPDX-License-Identifier: Apache-2.0
"""Passes warnings and errors of this process to an adapter that publishes them."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator

from motord.bus.inbox import Inbox

WAITING_MAX = 100


class LogListener(logging.Handler):
    """Log handler for records from any thread. `take` is called in the event loop; of too many
    records the oldest are lost."""

    def __init__(self, take: Callable[[logging.LogRecord], None]) -> None:
        super().__init__(logging.WARNING)
        self._waiting: Inbox[logging.LogRecord] = Inbox(WAITING_MAX, take)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Pass on what is logged while the context lasts."""
        self._waiting.open()
        logging.getLogger().addHandler(self)
        try:
            yield
        finally:
            logging.getLogger().removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Implement `logging.Handler.emit`."""
        self._waiting.put(record)
