# SPDX-License-Identifier: Apache-2.0
"""The reference board, compiled for this machine, on a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import tty
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
STRICT = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror", "-O1"]


def compiled(folder: Path) -> Path:
    """Compile the board and return the program."""
    program = folder / "mcu_host"
    sources = [ROOT / "docs/mcu/motord_mcu.c", ROOT / "tests/contract/boards/mcu_host.c"]
    flags = [*STRICT, "-D_DEFAULT_SOURCE", f"-I{ROOT / 'docs/mcu'}"]
    subprocess.run(["cc", *flags, "-o", program, *sources], check=True, timeout=60)
    return program


@dataclass(frozen=True)
class Sent:
    """Command that the board gives its two motors."""

    enabled: bool
    braking: bool
    left_mrad_s: int
    right_mrad_s: int
    duty: int


WITHOUT_POWER = Sent(enabled=False, braking=False, left_mrad_s=0, right_mrad_s=0, duty=0)


class McuPeer:
    """A board that runs until it is pulled. `sent` gets each changed command to its motors."""

    def __init__(self, program: Path, link: Path) -> None:
        self.link = link
        self.sent: list[Sent] = []
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        self.process = subprocess.Popen(
            [program, str(self.master)],
            pass_fds=[self.master],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        with contextlib.suppress(PermissionError):  # a board does not wait for a CPU
            os.setpriority(os.PRIO_PROCESS, self.process.pid, -15)
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            enabled, braking, left, right, duty = (int(word) for word in line.split())
            self.sent.append(Sent(bool(enabled), bool(braking), left, right, duty))

    def do(self, letter: str) -> None:
        """Change the board: f fault, g fault gone, r restart, m mute, d drop what it receives,
        w end m and d, i add a sensor, t turn the first motor backward by hand, s release it."""
        assert self.process.stdin is not None
        self.process.stdin.write(letter.encode())
        self.process.stdin.flush()

    @property
    def now(self) -> Sent:
        """The newest command; WITHOUT_POWER before the first one."""
        return self.sent[-1] if self.sent else WITHOUT_POWER

    def pull(self) -> None:
        """Unplug the board: end its program and remove its port."""
        if self.process.stdin is not None and not self.process.stdin.closed:
            self.process.stdin.close()
            self.process.wait(10)
            self._reader.join()
            self.process.stdout.close()
            self.link.unlink()
            os.close(self.master)
            os.close(self._slave)
