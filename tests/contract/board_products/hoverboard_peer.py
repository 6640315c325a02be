# SPDX-License-Identifier: Apache-2.0
"""hoverboard_peer.c, compiled: a hoverboard's main board on a pseudo-terminal, and a program that
drives one."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import tty
from pathlib import Path

from mcu_peer import STRICT

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import JointSpec, LineSpec

SOURCE = Path(__file__).with_suffix(".c")


def compiled(folder: Path, source: Path = SOURCE) -> Path:
    program = folder / source.stem
    flags = [*STRICT, "-D_DEFAULT_SOURCE"]
    subprocess.run(["cc", *flags, "-o", program, source], check=True, timeout=60)
    return program


class Program:
    """A process that runs until `end`; each line of numbers that it prints is added to `lines`."""

    def __init__(self, *arguments: object, pass_fds: tuple[int, ...] = ()) -> None:
        self.lines: list[tuple[int, ...]] = []
        self.process = subprocess.Popen(
            [str(argument) for argument in arguments],
            pass_fds=pass_fds,
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
            self.lines.append(tuple(int(word) for word in line.split()))

    def do(self, letter: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(letter.encode())
        self.process.stdin.flush()

    def end(self) -> None:
        """Close the program's input and wait for its end."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        assert self.process.wait(60) == 0
        self._close()

    def kill(self) -> None:
        """Kill the program: the board gets no more frames."""
        assert self.process.stdin is not None
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self._close()

    def _close(self) -> None:
        assert self.process.stdout is not None
        self._reader.join()
        self.process.stdout.close()


class Board(Program):
    """A board whose port is `link`. Its lines: left speed, right speed, 1 after its time-out. Its
    program gets `arguments`, the descriptor of its port, and `options`."""

    def __init__(self, link: Path, *arguments: object, options: tuple[str, ...] = ()) -> None:
        self.link = link
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        super().__init__(*arguments, self.master, *options, pass_fds=(self.master,))

    @property
    def now(self) -> tuple[int, ...]:
        """The newest line; zeros before the first one."""
        return self.lines[-1] if self.lines else (0, 0, 0)

    def end(self) -> None:
        super().end()
        os.close(self.master)
        os.close(self._slave)
        self.link.unlink()


def spec_of(link: Path, drive: str = "hoverboard") -> LineSpec:
    profile = find_profile(drive)
    joints = (
        JointSpec(index=0, name="left", profile=profile, unit=1, channel=1),
        JointSpec(index=1, name="right", profile=profile, unit=1, channel=2, inverted=True),
    )
    return LineSpec(
        index=0, name="board", kind="hoverboard", port=str(link), baudrate=115200, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine="auto", joints=joints, watchdog_s=0.2,
        priority=0,
    )  # fmt: skip
