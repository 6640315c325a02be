# SPDX-License-Identifier: Apache-2.0
"""The daemon, and a thread in it that records which counts the core is given.

It reads the mailboxes of the exchange without taking from them: the slot that their reader holds,
with the layout of csrc/base/mailbox.h and csrc/loop/exchange.h. A value that is read wrongly is no
drive's count, so an error here cannot hide a wrong count. Each new count is a line in the file
TAP_FILE:

    JOINT STAMP_NS COUNT EPOCH
"""

import os
import threading
import time
from pathlib import Path

from _motord_rt import ffi, lib

from motord.__main__ import main

LOOK_EVERY_S = 0.01
"""Period of the look at the mailboxes; a cycle of the line takes 40 ms."""
CACHE_LINE_BYTES = 64
MAILBOX_BYTES = 3 * CACHE_LINE_BYTES
FRONT_AT = 2 * CACHE_LINE_BYTES
SLOTS = 3


def aligned(size_bytes: int) -> int:
    return -(-size_bytes // CACHE_LINE_BYTES) * CACHE_LINE_BYTES


def box_bytes(value: str) -> int:
    return aligned(MAILBOX_BYTES + SLOTS * ffi.sizeof(value))


class Peephole:
    """Reader of the feedback of one joint in its mailbox."""

    def __init__(self, joint: int) -> None:
        before = ("lease_permissions", "command_report", "core_control")
        place = sum(map(box_bytes, before)) + joint * box_bytes("joint_feedback")
        box = ffi.cast("char *", lib.loop_exchange()) + place
        self._front = ffi.cast("volatile uint32_t *", box + FRONT_AT)
        self._slots = ffi.cast("joint_feedback *", box + MAILBOX_BYTES)
        self._stamp_ns = 0

    def row(self) -> str | None:
        front = self._front[0]
        found = ffi.new("joint_feedback *", self._slots[front])
        if self._front[0] != front or found.stamp_ns in (0, self._stamp_ns):
            return None
        self._stamp_ns = found.stamp_ns
        return f"{found.stamp_ns} {found.count} {found.epoch}"


def watch(path: Path, joints: int) -> None:
    holes = [Peephole(joint) for joint in range(joints)]
    with path.open("w", encoding="ascii", buffering=1) as file:
        while True:
            for joint, hole in enumerate(holes):
                if (row := hole.row()) is not None:
                    file.write(f"{joint} {row}\n")
            time.sleep(LOOK_EVERY_S)


threading.Thread(
    target=watch, args=(Path(os.environ["TAP_FILE"]), int(os.environ["TAP_JOINTS"])), daemon=True
).start()
main()
