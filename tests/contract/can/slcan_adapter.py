# SPDX-License-Identifier: Apache-2.0
"""The firmware's side of an slcan adapter on a pty: the ASCII protocol of LAWICEL's CAN232 manual,
chapters 2 and 3, with a bus on which tests send and receive."""

from __future__ import annotations

import contextlib
import os
import tty
from collections import deque

import can

OK, BELL = b"\r", b"\a"


class SlcanAdapter:
    """An adapter that is plugged in at `link`. `recv` and `send` are its side of the bus; a frame
    that is sent while its channel is closed is lost."""

    def __init__(self, link):
        self.link = link
        self.commands = []
        self.is_open = False
        self._frames = deque()
        self._line = b""
        self._master = -1
        self.plug()

    @property
    def address(self):
        return f"slcan:{self.link}"

    def plug(self):
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        fresh = self.link.with_name("fresh")
        fresh.symlink_to(os.ttyname(slave))
        fresh.replace(self.link)
        os.close(slave)

    def pull(self):
        self.link.unlink()
        os.close(self._master)
        self._master, self.is_open = -1, False

    def shutdown(self):
        if self._master >= 0:
            os.close(self._master)
            self._master = -1

    def say(self, data):
        """Send the host these raw bytes; they are lost if no program reads them."""
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)

    def _receive(self):
        if self._master < 0:
            return
        with contextlib.suppress(OSError):  # no program has the other end open
            self._line += os.read(self._master, 4096)
        while b"\r" in self._line:
            command, _, self._line = self._line.partition(b"\r")
            self._obey(command.decode("ascii"))

    def _obey(self, command):
        self.commands.append(command)
        if command in ("O", "C"):
            self.is_open = command == "O"
            self.say(OK)
        elif command[:1] == "S":
            self.say(BELL if self.is_open else OK)
        elif command[:1] in ("t", "r") and self.is_open:
            self._frames.append(_message(command))
            self.say(b"z\r")
        else:
            self.say(BELL)

    def recv(self, timeout=None):
        self._receive()
        return self._frames.popleft() if self._frames else None

    def send(self, message, timeout=None):
        if self.is_open:
            data = bytes(message.data).hex().upper()
            self.say(f"t{message.arbitration_id:03X}{message.dlc}{data}\r".encode("ascii"))


def _message(command):
    remote, size = command[0] == "r", int(command[4])
    data = bytes.fromhex(command[5:])
    assert len(data) == (0 if remote else size), command
    return can.Message(
        arbitration_id=int(command[1:4], 16),
        is_extended_id=False,
        is_remote_frame=remote,
        dlc=size,
        data=data,
    )
