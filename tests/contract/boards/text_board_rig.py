# SPDX-License-Identifier: Apache-2.0
"""A line of text boards, and a reader of what it sends."""

import os
import threading
import tty

from motord.config.drives.load import find_profile
from motord_hal.fieldbus.ports import (
    JointSpec,
    LineSpec,
    TextSpec,
    TextWheel,
)

WHEELS = {"left": TextWheel(side=-1, radius_m=0.1), "right": TextWheel(side=1, radius_m=0.1)}


class Reader:
    """The board's end: keeps the lines that it receives, and sends what a test gives it."""

    def __init__(self, link):
        self.link = link
        self.lines = []
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.symlink_to(os.ttyname(self._slave))
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self):
        came = tail = b""
        while b"!" not in came:  # a read may begin or end with lines
            came = os.read(self.master, 4096)
            *lines, tail = (tail + came).split(b"\n")
            self.lines += lines

    def say(self, text):
        os.write(self.master, text)

    def close(self):
        os.write(self._slave, b"!")
        self._thread.join()
        os.close(self.master)
        os.close(self._slave)
        self.link.unlink()


def spec_of(port, setpoints, feedback="", drive="ascii-duty", scale=255.0):
    profile = find_profile(drive)
    joints = (
        JointSpec(index=0, name="left", profile=profile, unit=1, channel=1),
        JointSpec(index=1, name="right", profile=profile, unit=1, channel=2, inverted=True),
    )
    text = TextSpec(setpoints=setpoints, feedback=feedback, scale=scale, wheels=WHEELS, track_m=0.5)
    return LineSpec(
        index=0, name="board", kind="ascii", port=str(port), baudrate=115200, parity="none",
        stop_bits=1, cycle_hz=100.0, gap_s=None, engine="auto", joints=joints, text=text,
        watchdog_s=0.2,
    )  # fmt: skip
