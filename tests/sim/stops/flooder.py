# SPDX-License-Identifier: Apache-2.0
"""flooder.py SOCKET: takes a lease and sends commands as datagrams, as many as it can, for ever."""

import socket
import sys
import time

from motord.api.commands import datagram
from motord.client import Client

if __name__ == "__main__":
    with Client(sys.argv[1]) as robot, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        grant = robot.call("lease", owner="flood")
        sender.connect(grant["socket"])
        print("flooding", flush=True)
        sequence = 0
        while True:
            sequence += 1
            token = bytes.fromhex(grant["token"])
            sender.send(datagram(token, sequence, time.monotonic_ns(), 0.1, 0.0))
