# SPDX-License-Identifier: Apache-2.0
"""Reading the parts of a drive profile that only a drive on a CAN bus has: [can], [frame.*] and
[signal.*]."""

from __future__ import annotations

import re

from motord_hal.drives.can_profile import SIZES_FD, STANDARD_ID_MAX, CanTable, Frame, Sender, Signal
from motord_hal.drives.profile import SI_UNITS, Register, RegisterType
from motord_hal.drives.toml_table import Table

EXTENDED_ID_MAX = 0x1FFF_FFFF
NODE_MAX = 255
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_TYPES = ("u8", "i8", "u16", "i16", "u32", "i32", "f32")
_BOUND = 1e12
_ANY_BYTE = -1
"""Of `begins`: whatever stands there."""


def read_table(can: Table, frames: Table) -> CanTable:
    """[can] and [frame.*]; the caller finishes [can]."""
    shift = can.integer("node_shift", 0, 24, 0)
    extended = can.flag("extended", default=False)
    fd = can.flag("fd", default=False)
    found = {}
    for name in frames:
        if not _NAME.fullmatch(name):
            frames.complain(name, "a frame's name is lower case letters, digits and _")
        found[name] = _frame(name, frames.table(name), shift, extended=extended, fd=fd)
    if not found:
        frames.problems.add(frames.name, "there is no frame")
    return CanTable(
        frames=found,
        node_min=can.integer("node_min", 0, NODE_MAX, 0),
        node_max=can.integer("node_max", 0, NODE_MAX),
        idle_setpoints=can.flag("idle_setpoints", default=True),
        hello=can.text("hello") if "hello" in can else "",
        sync=can.text("sync", choices=list(found)) if "sync" in can else "",
    )


def _frame(name: str, table: Table, shift: int, *, extended: bool, fd: bool) -> Frame:
    extended = table.flag("extended", default=extended)
    fd = table.flag("fd", default=fd)
    begins = table.integers("begins", _ANY_BYTE, 0xFF)
    frame = Frame(
        name=name,
        base=table.integer("id", 0, EXTENDED_ID_MAX if extended else STANDARD_ID_MAX),
        node_shift=table.integer("node_shift", 0, 24, shift),
        extended=extended,
        fd=fd,
        size_bytes=table.one_of("bytes", SIZES_FD if fd else SIZES_FD[:9]),
        sender=Sender(table.text("sender", choices=[one.value for one in Sender]) or "drive"),
        begins=bytes(max(byte, 0) for byte in begins),
        open_at=frozenset(at for at, byte in enumerate(begins) if byte < 0),
        ask=table.text("ask") if "ask" in table else "",
        period_s=table.number("period_s", 0.0005, 60.0, unit="s") if "period_s" in table else 0.0,
        silence_s=table.number("silence_s", 0.001, 60.0, unit="s") if "silence_s" in table else 0.0,
        source=table.text("source"),
        addressed=table.flag("addressed", default=True),
        short=table.flag("short", default=False),
        answers=table.text("answers") if "answers" in table else "",
        node_byte=table.integer("node_byte", 0, 63) if "node_byte" in table else None,
    )
    table.finish()
    return frame


def read_signals(parent: Table, frames: dict[str, Frame], pole_pairs: int) -> dict[str, Register]:
    """[signal.*] by name."""
    found: dict[str, Register] = {}
    for name in parent:
        if not _NAME.fullmatch(name):
            parent.complain(name, "a signal's name is lower case letters, digits and _")
        found[name] = _signal(name, parent.table(name), frames, pole_pairs)
    if not found:
        parent.problems.add(parent.name, "there is no signal")
    return found


def _signal(name: str, table: Table, frames: dict[str, Frame], pole_pairs: int) -> Signal:
    kind = RegisterType(table.text("type", choices=_TYPES) or "u8")
    frame = frames.get(table.text("frame", choices=list(frames)))
    reply = table.text("reply", choices=list(frames)) if "reply" in table else ""
    access = "r" if frame and frame.sender is Sender.DRIVE else "rw" if reply else "w"
    unit = table.text("unit", "", choices=(*SI_UNITS, "erpm"))
    electrical = unit == "erpm"
    if electrical and not pole_pairs:
        table.complain("unit", '"erpm" needs motor.pole_pairs to become a speed')
    per = max(pole_pairs, 1) if electrical else 1
    minimum = table.number("minimum", -_BOUND, _BOUND) if "minimum" in table else None
    maximum = table.number("maximum", -_BOUND, _BOUND) if "maximum" in table else None
    signal = Signal(
        name=name,
        address=frame.base if frame else 0,
        type=kind,
        scale=table.number("scale", -_BOUND, _BOUND, 1.0) / per,
        unit="rpm" if electrical else unit,
        access=access,
        offset=table.number("offset", -_BOUND, _BOUND, 0.0) / per,
        minimum=None if minimum is None else minimum / per,
        maximum=None if maximum is None else maximum / per,
        source=table.text("source"),
        default=table.integer("default", -(1 << 31), (1 << 32) - 1, 0),
        frame=frame.name if frame else "",
        reply_frame=reply,
        object=table.text("object") if "object" in table else "",
        start_bit=table.integer("start_bit", 0, 511),
        length=table.integer("length", 1, kind.bits, kind.bits),
        big_endian=table.text("byte_order", "little", choices=("little", "big")) == "big",
    )
    table.finish()
    return signal
