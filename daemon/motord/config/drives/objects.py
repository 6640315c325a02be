# SPDX-License-Identifier: Apache-2.0
"""[object.*] of a drive profile: entries of a CANopen object dictionary, each as frames of
expedited SDO transfers and one signal (CiA 301, 7.2.4.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from motord.config.drives.can_tables import CanObject
from motord_hal.drives import can_profile as can
from motord_hal.drives.profile import Register, RegisterType

SDO_REQUEST, SDO_REPLY = 0x600, 0x580
"""Identifiers of the predefined connection set: CiA 301, 7.3.5."""
_DOWNLOAD = {8: 0x2F, 16: 0x2B, 32: 0x23}
"""First byte of an expedited download, by its number of bits: CiA 301, 7.2.4.3.3."""
_UPLOADED = {8: 0x4F, 16: 0x4B, 32: 0x43}
"""First byte of the reply to an upload, by its number of bits: 7.2.4.3.6."""
_UPLOADED_UNSAID = 0x42
"""First byte of that reply if the server does not give the number of bytes."""
_UPLOAD, _DOWNLOADED, _ABORT = 0x40, 0x60, 0x80
_DATA_BIT = 32


def _reserve(name: str, base: int, sender: can.Sender, *, addressed: bool = True) -> can.Reserved:
    return can.Reserved(
        name=name,
        base=base,
        mask=can.STANDARD_ID_MAX,
        node_shift=0,
        extended=False,
        sender=sender,
        addressed=addressed,
        source="CiA 301, 7.3.5",
    )


PREDEFINED = (
    _reserve("NMT", 0x000, can.Sender.MOTORD, addressed=False),
    _reserve("SYNC", 0x080, can.Sender.MOTORD, addressed=False),
    _reserve("TIME", 0x100, can.Sender.MOTORD, addressed=False),
    _reserve("EMCY", 0x080, can.Sender.DRIVE),
    *(_reserve(f"TPDO {n + 1}", 0x180 + 0x100 * n, can.Sender.DRIVE) for n in range(4)),
    *(_reserve(f"RPDO {n + 1}", 0x200 + 0x100 * n, can.Sender.MOTORD) for n in range(4)),
    _reserve("SDO reply", SDO_REPLY, can.Sender.DRIVE),
    _reserve("SDO request", SDO_REQUEST, can.Sender.MOTORD),
    _reserve("heartbeat", 0x700, can.Sender.DRIVE),
)
"""The predefined connection set: what each CANopen drive sends and obeys as delivered, whatever of
it motord uses."""


def with_objects(
    table: can.CanTable, objects: Mapping[str, CanObject]
) -> tuple[can.CanTable, dict[str, Register]]:
    """Return the table with the frames of these objects, and their signals by name."""
    frames, signals = dict(table.frames), dict[str, Register]()
    frames[can.ABORT_FRAME] = _frame(can.ABORT_FRAME, can.Sender.DRIVE, bytes((_ABORT,)))
    signals[can.ABORT_CODE] = _signal(can.ABORT_CODE, can.ABORT_FRAME, RegisterType.U32, "r")
    for name, entry in objects.items():
        found, signal = _object(name, entry)
        frames |= {frame.name: frame for frame in found}
        signals[name] = signal
    reserved = (*table.reserved, *PREDEFINED)
    return replace(table, frames=frames, abort=can.ABORT_FRAME, reserved=reserved), signals


def _object(name: str, entry: CanObject) -> tuple[list[can.Frame], can.Signal]:
    kind, writable = RegisterType(entry.type or "u8"), entry.access == "rw"
    place = entry.index.to_bytes(2, "little") + bytes((entry.sub,))
    ask, read = f"sdo_ask_{name}", f"sdo_read_{name}"
    write, wrote = f"sdo_write_{name}", f"sdo_wrote_{name}"
    frames = [
        _frame(ask, can.Sender.MOTORD, bytes((_UPLOAD,)) + place),
        replace(
            _frame(read, can.Sender.DRIVE, bytes((_UPLOADED[kind.bits],)) + place, ask=ask),
            or_begins=bytes((_UPLOADED_UNSAID,)) + place,
        ),
    ]
    if writable:
        download = _frame(write, can.Sender.MOTORD, bytes((_DOWNLOAD[kind.bits],)) + place)
        frames.append(replace(download, confirm=wrote))
        frames.append(_frame(wrote, can.Sender.DRIVE, bytes((_DOWNLOADED,)) + place))
    signal = replace(
        _signal(name, write if writable else read, kind, entry.access),
        scale=entry.scale,
        unit=entry.unit,
        source=entry.source or f"object {entry.index:04X}h:{entry.sub:02X}h",
        default=entry.default,
        reply_frame=read if writable else "",
    )
    return frames, signal


def _frame(name: str, sender: can.Sender, begins: bytes, ask: str = "") -> can.Frame:
    return can.Frame(
        name=name,
        base=SDO_REQUEST if sender is can.Sender.MOTORD else SDO_REPLY,
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


def _signal(name: str, frame: str, kind: RegisterType, access: str) -> can.Signal:
    return can.Signal(
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
