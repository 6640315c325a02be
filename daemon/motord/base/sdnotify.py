# SPDX-License-Identifier: Apache-2.0
"""Notifications to a service manager: sd_notify(3), sd_watchdog_enabled(3)."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping


class Notifier:
    """Sender of datagrams to $NOTIFY_SOCKET. Without a supervisor, and when it does not listen, it
    sends nothing."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        path = environ.get("NOTIFY_SOCKET", "")
        # "@name" is in the abstract name space, which the kernel spells with a leading NUL
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self.watchdog_s = _watchdog_s(environ)
        """The supervisor expects WATCHDOG=1 at least this often; None: it does not watch."""

    def _send(self, text: str) -> bool:
        """Send a text; return whether it was taken."""
        if not self._address:
            return False
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.settimeout(0.0)  # a full queue may not hold up the daemon
                sender.sendto(text.encode(), self._address)
        except OSError:
            return False
        return True

    def ready(self) -> bool:
        return self._send("READY=1")

    def stopping(self) -> bool:
        return self._send("STOPPING=1")

    def watchdog(self) -> bool:
        """Feed the watchdog. Call it only when everything that must move has moved."""
        return self._send("WATCHDOG=1")

    def status(self, text: str) -> bool:
        """Show one line in `systemctl status`."""
        return self._send(f"STATUS={' '.join(text.split())}")


def _watchdog_s(environ: Mapping[str, str]) -> float | None:
    """Return the watchdog's time-out. None also if the watchdog is meant for another process, or is
    not a number above 0."""
    try:
        watchdog_us = int(environ.get("WATCHDOG_USEC", ""))
        pid = int(environ.get("WATCHDOG_PID", os.getpid()))
    except ValueError:
        return None
    return watchdog_us / 1e6 if watchdog_us > 0 and pid == os.getpid() else None
