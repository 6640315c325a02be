# SPDX-License-Identifier: Apache-2.0
"""The other end of a measurement. It runs as a script in its own process, so that no load in the
measured process can delay it. It sends commands, and stamps the bytes that come back.

    peer.py SOCKET_FD PTY_FD COMMAND_HZ PRIORITY

Commands are packets of COMMAND on a SOCK_SEQPACKET. The code of a command comes back as a byte on
the pty when the command has passed asyncio, the loop and asyncio again. The script sends one byte
when it is ready, begins at the first packet that comes, ends at end of file and prints
{"sent": n, "samples": n, "max_ns": n, "counts": [[ns, n], ...]} on stdout.
"""

import json
import os
import random
import select
import signal
import socket
import struct
import sys
import time

COMMAND = struct.Struct("<qB")
"""A command: its stamp (CLOCK_MONOTONIC, ns) and its code."""
CODES = 250
"""Number of codes, used in turn from 1 on. At 100 commands a second an answer may take 2.5 s before
its code is used again."""


class Tally:
    """Counts times in 64 steps an octave, so that a run of a day needs no more memory than one of a
    minute. Each value counts as the upper end of its step, which is at most 1.6 % too high; the
    maximum is exact."""

    def __init__(self) -> None:
        self.samples = 0
        self.max_ns = 0
        self.counts: dict[int, int] = {}

    def add(self, value_ns: int) -> None:
        shift = max(value_ns.bit_length() - 7, 0)
        step_ns = ((value_ns >> shift) + 1 << shift) - 1
        self.counts[step_ns] = self.counts.get(step_ns, 0) + 1
        self.samples += 1
        self.max_ns = max(self.max_ns, value_ns)


class Peer:
    def __init__(self, commands: socket.socket, pty_fd: int, command_hz: float) -> None:
        self.commands, self.pty_fd = commands, pty_fd
        self.period_s = 1.0 / command_hz
        self.sent = 0
        self.given_ns: dict[int, int] = {}
        self.command_to_byte = Tally()

    def send(self) -> None:
        """Send a command. If the socket is full, drop it: the other side is too late for it."""
        code = self.sent % CODES + 1
        now_ns = time.monotonic_ns()
        self.sent += 1
        try:
            self.commands.send(COMMAND.pack(now_ns, code), socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        self.given_ns[code] = now_ns

    def receive(self) -> None:
        data = os.read(self.pty_fd, 4096)
        now_ns = time.monotonic_ns()
        for code in data:
            if (given_ns := self.given_ns.pop(code, None)) is not None:
                self.command_to_byte.add(now_ns - given_ns)

    def run(self) -> None:
        """Send commands and take bytes until the socket ends. The commands come at random times, so
        that they meet every phase of the loop's period."""
        when = random.Random()
        due_s = time.monotonic()
        while True:
            wait_s = max(due_s - time.monotonic(), 0.0)
            ready, _, _ = select.select([self.commands.fileno(), self.pty_fd], [], [], wait_s)
            if self.commands.fileno() in ready and not self.commands.recv(1):
                return
            if self.pty_fd in ready:
                self.receive()
            if time.monotonic() >= due_s:
                self.send()
                due_s = time.monotonic() + when.uniform(0.5, 1.5) * self.period_s


def raise_priority(priority: int) -> None:
    """Set SCHED_FIFO below the loop but above any load, so that the peer's own lateness does not
    change the result. If the system refuses it, change nothing."""
    if priority > 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except PermissionError:
            return


def main(socket_fd: int, pty_fd: int, command_hz: float, priority: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise_priority(priority)
    with socket.socket(fileno=socket_fd) as commands:
        commands.send(b"!")
        if not commands.recv(1):
            return
        peer = Peer(commands, pty_fd, command_hz)
        peer.run()
    tally = peer.command_to_byte
    found = {"samples": tally.samples, "max_ns": tally.max_ns, "counts": [*tally.counts.items()]}
    json.dump({"sent": peer.sent, **found}, sys.stdout)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]))
