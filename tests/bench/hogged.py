# SPDX-License-Identifier: Apache-2.0
"""motord with pure-Python threads beside it in its process, which want the GIL all the time: as
many as HOGS says, from SIGUSR1 on."""

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


signal.signal(signal.SIGUSR1, begin)
main()
