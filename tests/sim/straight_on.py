# SPDX-License-Identifier: Apache-2.0
"""straight_on.py SOCKET SPEED_M_S: a source that commands this speed until it is refused. It begins
with a zero: another one that a stop ended before may have left it held."""

import sys
import time

from motord.client import Client

if __name__ == "__main__":
    with Client(sys.argv[1]) as robot:
        robot.drive(0.0, 0.0, owner="source")
        while True:
            robot.drive(float(sys.argv[2]), 0.0, owner="source")
            time.sleep(0.05)
