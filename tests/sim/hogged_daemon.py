# SPDX-License-Identifier: Apache-2.0
"""The daemon with two faults in its process: a thread that keeps the GIL for 10 s, and a callback
that never returns.

The first begins with a line on the named pipe in HOG_PIPE. It calls sleep through PyDLL, which does
not release the GIL: no Python code runs in the process meanwhile. The second begins with SIGUSR1,
whose handler runs in the thread of the event loop.
"""

import ctypes
import os
import signal
import threading
import time

from motord.__main__ import main


def hog() -> None:
    with open(os.environ["HOG_PIPE"], encoding="ascii") as pipe:
        pipe.readline()
    ctypes.PyDLL(None).sleep(10)


def block(*_: object) -> None:
    while True:
        time.sleep(1.0)


signal.signal(signal.SIGUSR1, block)
threading.Thread(target=hog, daemon=True).start()
main()
