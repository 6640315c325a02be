# SPDX-License-Identifier: Apache-2.0
"""A daemon that a service manager supervises."""

import socket

WATCHDOG_S = 1.0

PATIENCE_S = 1.5 * WATCHDOG_S
"""Time after which a supervisor would surely have acted."""


def supervised(tmp_path):
    """Return a socket that listens as systemd's does, and the daemon's environment for it."""
    supervisor = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    supervisor.bind(str(tmp_path / "notify"))
    supervisor.settimeout(0.0)
    environ = {
        "NOTIFY_SOCKET": str(tmp_path / "notify"),
        "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6)),
    }
    return supervisor, environ


def notifications(supervisor):
    words = []
    try:
        while True:
            words.append(supervisor.recv(4096).decode())
    except BlockingIOError:
        return words


def fed(supervisor):
    return any("WATCHDOG=1" in word for word in notifications(supervisor))
