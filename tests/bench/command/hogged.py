# SPDX-License-Identifier: Apache-2.0
"""motord with HOGS pure-Python threads in its process, which compete for the GIL all the time from
SIGUSR1 on. The process runs on one CPU: hogs on every CPU would delay the kernel worker of ordinary
priority that passes on the bytes of a pty."""

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
