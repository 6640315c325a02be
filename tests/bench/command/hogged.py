# SPDX-License-Identifier: Apache-2.0
"""motord with pure-Python threads beside it in its process, which want the GIL all the time: as
many as HOGS says, from SIGUSR1 on. All of it shares one CPU: a pty hands bytes on by a kernel
worker of ordinary priority, and a bench that lets the hogs keep that worker waiting measures it."""

import os
import signal
import threading

from motord.__main__ import main


def hog() -> None:
    while True:
        sum(range(1000))


def begin(*_: object) -> None:
    for _ in range(int(os.environ["HOGS"])):
        threading.Thread(target=hog, daemon=True).start()


os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
signal.signal(signal.SIGUSR1, begin)
main()
