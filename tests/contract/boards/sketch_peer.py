# SPDX-License-Identifier: Apache-2.0
"""The reference sketch, compiled for this machine as its chip's Arduino core would compile it."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

from motord_hal.mcu.frames import Frame, Splitter, Type, build, parse

ROOT = Path(__file__).resolve().parents[3]
STUBS = ROOT / "tests/contract/boards/arduino"
STANDARDS = {"ESP32": "gnu++2a", "AVR": "gnu++11", "RP2040": "gnu++17"}
"""C++ standard that each chip's Arduino core sets (the newest ESP32 core: a newer one)."""
STRICT = ["-Wall", "-Wextra", "-Wshadow", "-Werror", "-O1"]
STEP_US = 1000
ENABLE, RESTART_NOTED = 1, 8
WATCHDOG_MS, FEEDBACK_MS = 100, 10


def compiled(folder: Path, chip: str) -> Path:
    """Compile the sketch for a chip and return the program."""
    include = [f"-I{ROOT / 'docs/mcu'}", f"-I{STUBS}"]
    board, program = folder / f"board_{chip}.o", folder / f"sketch_{chip}"
    source = ROOT / "docs/mcu/motord_mcu.c"
    subprocess.run(["cc", *STRICT, *include, "-c", source, "-o", board], check=True, timeout=120)
    flags = [*STRICT, *include, f"-std={STANDARDS[chip]}", f"-DARDUINO_ARCH_{chip}"]
    host = STUBS / "sketch_host.cpp"
    subprocess.run(["c++", *flags, host, board, "-o", program], check=True, timeout=120)
    return program


class Sketch:
    """A chip that runs the sketch. Its time advances only in `run`."""

    def __init__(self, program: Path) -> None:
        self.levels: dict[int, int] = {}
        self.pwm: dict[int, float] = {}
        self.writes: list[str] = []
        """Everything that the sketch did to the chip, in order."""
        self.feedback: list[bytes] = []
        """Payload of each feedback frame, in order."""
        self.watchdog_ms = 0
        self.now_us = 0
        self._sequence = 0
        self._splitter = Splitter()
        self._program = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def close(self) -> None:
        self._program.communicate(timeout=10)

    def do(self, order: str) -> None:
        assert self._program.stdin is not None
        assert self._program.stdout is not None
        self._program.stdin.write(order + "\n")
        self._program.stdin.flush()
        while (row := self._program.stdout.readline().rstrip("\n")) != "done":
            assert row, "the sketch has ended"
            self._note(row)

    def _note(self, row: str) -> None:
        self.writes.append(row)
        kind, *words = row.split()
        if kind == "level":
            self.levels[int(words[0])] = int(words[1])
        elif kind == "pwm":
            self.pwm[int(words[0])] = float(words[1])
        elif kind == "watchdog":
            self.watchdog_ms = int(words[0])
        elif kind == "sent":
            for piece in self._splitter.feed(bytes.fromhex(words[0])):
                self.feedback.append(parse(piece).payload)

    def run(self, seconds: float, *mrad_s: int, control: int | None = None) -> None:
        """Call loop() every millisecond; send set-points, if any, every ten milliseconds."""
        for step in range(round(seconds * 1e6 / STEP_US)):
            if mrad_s and step % 10 == 0:
                self.command(ENABLE if control is None else control, *mrad_s)
            self.now_us += STEP_US
            self.do(f"time {self.now_us}")
            self.do("loop")

    def command(self, control: int, *mrad_s: int) -> None:
        """Send the sketch a frame of set-points."""
        motors = b"".join(struct.pack("<ih", each, 0) for each in mrad_s)
        head = struct.pack("<BBHH", control, len(mrad_s), WATCHDOG_MS, FEEDBACK_MS)
        self._sequence += 1
        frame = Frame(Type.SETPOINTS, self._sequence, self.now_us, head + motors)
        self.do(f"in {build(frame).hex()}")

    def arm(self) -> None:
        self.run(0.02, 0, 0, control=RESTART_NOTED)
        self.run(0.02, 0, 0)

    def turn(self, a_pin: int, b_pin: int, edges: int) -> None:
        """Make quadrature edges on two pins, A before B if `edges` is positive."""
        row = [(1, 0), (1, 1), (0, 1), (0, 0)]
        for step in range(abs(edges)):
            a, b = row[step % 4] if edges > 0 else row[::-1][(step + 1) % 4]
            self.do(f"level {a_pin} {a}")
            self.do(f"level {b_pin} {b}")
