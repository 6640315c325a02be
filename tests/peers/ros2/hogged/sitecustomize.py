# SPDX-License-Identifier: Apache-2.0
"""With this folder in PYTHONPATH, SIGUSR1 starts HOGS pure-Python threads in the process of
motord-bus, which compete for the GIL all the time. SIGWINCH blocks its event loop. SIGUSR2 ends
both."""

import os
import signal
import sys
import threading

_end = threading.Event()


def hog() -> None:
    while not _end.is_set():
        sum(range(1000))


def begin(*_: object) -> None:
    _end.clear()
    for _ in range(int(os.environ["HOGS"])):
        threading.Thread(target=hog, daemon=True).start()


def stand_still(*_: object) -> None:
    _end.clear()
    _end.wait()


if "motord.bus" in sys.orig_argv:
    signal.signal(signal.SIGUSR1, begin)
    signal.signal(signal.SIGWINCH, stand_still)
    signal.signal(signal.SIGUSR2, lambda *_: _end.set())
