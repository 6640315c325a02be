# SPDX-License-Identifier: Apache-2.0
"""connector.py SOCKET COUNT: holds COUNT silent connections. With a COUNT of 0 it connects and
closes for ever, as often as it can."""

import contextlib
import resource
import socket
import sys


def connection(path):
    opened = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    while True:
        with contextlib.suppress(BlockingIOError):
            opened.connect(path)
            return opened


if __name__ == "__main__":
    path, count = sys.argv[1], int(sys.argv[2])
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 65536), hard))
    held = [connection(path) for _ in range(count)]
    print("there", flush=True)
    if held:
        sys.stdin.read()
    while not held:
        with contextlib.suppress(OSError):
            connection(path).close()
