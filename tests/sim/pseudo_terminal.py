# SPDX-License-Identifier: Apache-2.0
"""A program at a terminal of its own, as over SSH, and the keyboard and screen of that terminal."""

import contextlib
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time

from tests.fork_server import AT_TERMINAL
from tests.sim.daemon_stage import DEADLINE_S, ROOT

PING, PONG = b"\x1b[5n", b"\x1b[0n"
REPEAT_S = 0.033
"""Period in which a keyboard repeats a held key."""


class PseudoTerminal:
    """A terminal. `answers`: whether it answers status requests, as one with a fast link does."""

    def __init__(self, *words, answers=True, columns=80, rows=24, environ=None):
        self.master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (rows, columns))
        self.before = termios.tcgetattr(slave)
        self.answers, self.screen, self._rest, self._slave = answers, b"", b"", slave
        self.process = subprocess.Popen(
            [*AT_TERMINAL, sys.executable, "-m", "motord", *words], cwd=ROOT,
            stdin=slave, stdout=slave, stderr=slave,
            env={**os.environ, "TERM": "xterm-256color", **(environ or {})},
        )  # fmt: skip

    @property
    def settings(self):
        return termios.tcgetattr(self._slave)

    def type(self, keys):
        os.write(self.master, keys.encode())

    def look(self, within_s=0.0):
        """Read what the program has written, and answer its status requests."""
        while select.select([self.master], [], [], within_s)[0]:
            try:
                data = os.read(self.master, 65536)
            except OSError:  # the program has ended
                return
            self.screen += data
            pings = (self._rest + data).count(PING)
            self._rest = (self._rest + data)[-len(PING) + 1 :]
            if pings and self.answers:
                os.write(self.master, PONG * pings)
            within_s = 0.0

    @property
    def text(self):
        """The screen's text without control sequences."""
        plain = re.sub(rb"\x1b\[[0-?]*[ -/]*[@-~]|\x1b[()][0-9A-B]|\x1b[=>]", b"", self.screen)
        return plain.decode(errors="replace")

    def wait_until(self, condition, what, keys=""):
        """Wait for the condition with `keys` held down; return its value."""
        end_s = time.monotonic() + DEADLINE_S
        while not (found := condition()):
            assert time.monotonic() < end_s, f"{what}: not within {DEADLINE_S} s\n{self.text}"
            if keys:
                self.type(keys)
            self.look(REPEAT_S)
            time.sleep(REPEAT_S / 10)
        return found

    def wait_for(self, text):
        self.wait_until(lambda: text in self.text, text)

    def exit_status(self):
        self.wait_until(lambda: self.process.poll() is not None, "its end")
        self.look()  # its last output may have come after the last read
        return self.process.returncode

    def hang_up(self):
        """Close the terminal, as a closed window or a broken connection does."""
        os.close(self._slave)
        os.close(self.master)
        self._slave = self.master = -1

    def close(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.kill()
        self.process.wait()
        for fd in (self.master, self._slave):
            if fd >= 0:
                os.close(fd)


@contextlib.contextmanager
def at_terminal(*words, **options):
    terminal = PseudoTerminal(*words, **options)
    try:
        yield terminal
    finally:
        terminal.close()
