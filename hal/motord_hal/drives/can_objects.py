# SPDX-License-Identifier: Apache-2.0
"""[object.*] of a drive profile: entries of a CANopen object dictionary, as frames of expedited SDO
transfers and one signal each (CiA 301, 7.2.4.3)."""

from __future__ import annotations

from dataclasses import replace

from motord_hal.drives.can_profile import CanTable, Frame, Sender, Signal
from motord_hal.drives.profile import SI_UNITS, Register, RegisterType
from motord_hal.drives.toml_table import Table

SDO_REQUEST, SDO_REPLY = 0x600, 0x580
"""CiA 301, 7.3.5: the predefined connection set."""
ABORT_FRAME, ABORT_CODE = "sdo_abort", "sdo_abort_code"
_DOWNLOAD = {8: 0x2F, 16: 0x2B, 32: 0x23}
"""Initiate download, expedited, so many bits: CiA 301, 7.2.4.3.3."""
_UPLOADED = {8: 0x4F, 16: 0x4B, 32: 0x43}
"""The reply to an upload, 7.2.4.3.6, where the server says how many bytes count,"""
_UPLOADED_UNSAID = 0x42
"""and where it does not."""
_UPLOAD, _DOWNLOADED, _ABORT = 0x40, 0x60, 0x80
_TYPES = ("u8", "i8", "u16", "i16", "u32", "i32")
_DATA_BIT = 32
_BOUND = 1e12


def read_objects(parent: Table, table: CanTable) -> tuple[CanTable, dict[str, Register]]:
    """The table with the frames of these objects, and their signals by name."""
    frames, signals = dict(table.frames), dict[str, Register]()
    frames[ABORT_FRAME] = _frame(ABORT_FRAME, Sender.DRIVE, bytes((_ABORT,)))
    signals[ABORT_CODE] = _signal(ABORT_CODE, ABORT_FRAME, RegisterType.U32, "r")
    for name in parent:
        found, signal = _object(name, parent.table(name))
        frames |= {frame.name: frame for frame in found}
        signals[name] = signal
    return replace(table, frames=frames, abort=ABORT_FRAME), signals


def _object(name: str, table: Table) -> tuple[list[Frame], Signal]:
    index, sub = table.integer("index", 0x1000, 0xFFFF), table.integer("sub", 0, 255, 0)
    kind = RegisterType(table.text("type", choices=_TYPES) or "u8")
    access = table.text("access", "rw", choices=("r", "rw"))
    place = index.to_bytes(2, "little") + bytes((sub,))
    ask, read = f"sdo_ask_{name}", f"sdo_read_{name}"
    write, wrote = f"sdo_write_{name}", f"sdo_wrote_{name}"
    frames = [
        _frame(ask, Sender.MOTORD, bytes((_UPLOAD,)) + place),
        replace(
            _frame(read, Sender.DRIVE, bytes((_UPLOADED[kind.bits],)) + place, ask=ask),
            or_begins=bytes((_UPLOADED_UNSAID,)) + place,
        ),
    ]
    if access == "rw":
        download = _frame(write, Sender.MOTORD, bytes((_DOWNLOAD[kind.bits],)) + place)
        frames.append(replace(download, confirm=wrote))
        frames.append(_frame(wrote, Sender.DRIVE, bytes((_DOWNLOADED,)) + place))
    signal = replace(
        _signal(name, write if access == "rw" else read, kind, access),
        scale=table.number("scale", -_BOUND, _BOUND, 1.0),
        unit=table.text("unit", "", choices=list(SI_UNITS)),
        source=table.text("source", f"object {index:04X}h:{sub:02X}h"),
        default=table.integer("default", -(1 << 31), (1 << 32) - 1, 0),
        reply_frame=read if access == "rw" else "",
    )
    table.finish()
    return frames, signal


def _frame(name: str, sender: Sender, begins: bytes, ask: str = "") -> Frame:
    return Frame(
        name=name,
        base=SDO_REQUEST if sender is Sender.MOTORD else SDO_REPLY,
        node_shift=0,
        extended=False,
        fd=False,
        size_bytes=8,
        sender=sender,
        begins=begins,
        ask=ask,
        period_s=0.0,
        silence_s=0.0,
        source="CiA 301, 7.2.4.3",
    )


def _signal(name: str, frame: str, kind: RegisterType, access: str) -> Signal:
    return Signal(
        name=name,
        address=0,
        type=kind,
        scale=1.0,
        unit="",
        access=access,
        minimum=None,
        maximum=None,
        source="CiA 301, 7.2.4.3",
        frame=frame,
        start_bit=_DATA_BIT,
        length=kind.bits,
        big_endian=False,
    )
