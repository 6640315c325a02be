# SPDX-License-Identifier: Apache-2.0
"""The daemon with a bad neighbour in its process: a thread that keeps the GIL for 10 s.

It begins when a line comes through the named pipe in HOG_PIPE. The sleep is called through PyDLL,
which does not release the GIL: no Python line runs anywhere in the process meanwhile.
"""

import ctypes
import os
import threading

from motord.__main__ import main


def hog() -> None:
    with open(os.environ["HOG_PIPE"], encoding="ascii") as pipe:
        pipe.readline()
    ctypes.PyDLL(None).sleep(10)


threading.Thread(target=hog, daemon=True).start()
main()
