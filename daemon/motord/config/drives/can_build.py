# SPDX-License-Identifier: Apache-2.0
"""Builder of the frames and signals of a drive on a CAN bus from its tables."""

from __future__ import annotations

from collections.abc import Mapping

from motord.config.drives.can_tables import CanBus, CanFrame, CanSignal, ReservedIds
from motord.config.drives.problems import Problems
from motord_hal.base.nearest import did_you_mean
from motord_hal.drives.can_profile import (
    EXTENDED_ID_MAX,
    SIZES_FD,
    STANDARD_ID_MAX,
    CanTable,
    Frame,
    Reserved,
    Sender,
    Signal,
)
from motord_hal.drives.profile import Register, RegisterType

_ANY_BYTE = -1
"""Value in `begins` for any byte."""
_CLASSIC_BYTES_MAX = 8


def can_table(
    can: CanBus,
    frames: Mapping[str, CanFrame],
    reserved: Mapping[str, ReservedIds],
    problems: Problems,
) -> CanTable:
    """Return the table of [can], [frame.*] and [reserved.*]."""
    found = {name: _frame(name, frame, can, problems) for name, frame in frames.items()}
    if not found:
        problems.add("frame", "there is no frame")
    return CanTable(
        frames=found,
        node_min=can.node_min,
        node_max=can.node_max,
        idle_setpoints=can.idle_setpoints,
        hello=can.hello or "",
        sync=_frame_name("can.sync", can.sync, found, problems),
        reserved=tuple(_reserved(name, ids, can, problems) for name, ids in reserved.items()),
    )


def _reserved(name: str, table: ReservedIds, can: CanBus, problems: Problems) -> Reserved:
    extended = can.extended if table.extended is None else table.extended
    most = EXTENDED_ID_MAX if extended else STANDARD_ID_MAX
    found = Reserved(
        name=name,
        base=table.id,
        mask=most if table.mask is None else table.mask,
        node_shift=can.node_shift if table.node_shift is None else table.node_shift,
        extended=extended,
        sender=Sender(table.sender),
        addressed=table.addressed,
        source=table.source,
    )
    if max(found.identifier(can.node_max), found.mask) > most:
        problems.add(f"reserved.{name}.id", f"with node {can.node_max} it is beyond {most:#x}")
    return found


def _frame(name: str, table: CanFrame, can: CanBus, problems: Problems) -> Frame:
    key = f"frame.{name}"
    for part in ("id", "bytes", "sender", "source"):
        if getattr(table, part) is None:
            problems.add(f"{key}.{part}", "is missing")
    extended = can.extended if table.extended is None else table.extended
    fd = can.fd if table.fd is None else table.fd
    base, size_bytes = table.id or 0, table.bytes or 0
    if not extended and base > STANDARD_ID_MAX:
        problems.add(f"{key}.id", f"{base} is out of range (0 to {STANDARD_ID_MAX})")
    if not fd and size_bytes > _CLASSIC_BYTES_MAX:
        sizes = ", ".join(map(str, SIZES_FD[: _CLASSIC_BYTES_MAX + 1]))
        problems.add(f"{key}.bytes", f"{size_bytes} is not one of {sizes}")
    return Frame(
        name=name,
        base=base,
        node_shift=can.node_shift if table.node_shift is None else table.node_shift,
        extended=extended,
        fd=fd,
        size_bytes=size_bytes,
        sender=Sender(table.sender or Sender.DRIVE),
        begins=bytes(max(byte, 0) for byte in table.begins),
        open_at=frozenset(at for at, byte in enumerate(table.begins) if byte == _ANY_BYTE),
        ask=table.ask or "",
        period_s=table.period_s or 0.0,
        silence_s=table.silence_s or 0.0,
        source=table.source or "",
        addressed=table.addressed,
        short=table.short,
        answers=table.answers or "",
        node_byte=table.node_byte,
    )


def _frame_name(key: str, name: str | None, frames: Mapping[str, Frame], problems: Problems) -> str:
    """Return the name if there is such a frame; else add a problem, and return an empty text."""
    if name is None or name in frames:
        return name or ""
    known = ", ".join(f'"{frame}"' for frame in frames)
    problems.add(key, f'"{name}" is not one of {known}{did_you_mean(name, frames)}')
    return ""


def can_signals(
    signals: Mapping[str, CanSignal],
    frames: Mapping[str, Frame],
    pole_pairs: int,
    problems: Problems,
) -> dict[str, Register]:
    """Return the signals of [signal.*] by name."""
    if not signals:
        problems.add("signal", "there is no signal")
    return {
        name: _signal(name, table, frames, pole_pairs, problems) for name, table in signals.items()
    }


def _signal(
    name: str,
    table: CanSignal,
    frames: Mapping[str, Frame],
    pole_pairs: int,
    problems: Problems,
) -> Signal:
    key = f"signal.{name}"
    for part in ("type", "start_bit", "source"):
        if getattr(table, part) is None:
            problems.add(f"{key}.{part}", "is missing")
    kind = RegisterType(table.type or "u8")
    if table.length is not None and table.length > kind.bits:
        problems.add(f"{key}.length", f"{table.length} is out of range (1 to {kind.bits})")
    frame = frames.get(_frame_name(f"{key}.frame", table.frame, frames, problems))
    reply = _frame_name(f"{key}.reply", table.reply, frames, problems)
    electrical = table.unit == "erpm"
    if electrical and not pole_pairs:
        problems.add(f"{key}.unit", '"erpm" needs motor.pole_pairs to become a speed')
    per = max(pole_pairs, 1) if electrical else 1
    return Signal(
        name=name,
        address=frame.base if frame else 0,
        type=kind,
        scale=table.scale / per,
        unit="rpm" if electrical else table.unit,
        access="r" if frame and frame.sender is Sender.DRIVE else "rw" if reply else "w",
        offset=table.offset / per,
        minimum=None if table.minimum is None else table.minimum / per,
        maximum=None if table.maximum is None else table.maximum / per,
        source=table.source or "",
        default=table.default,
        frame=frame.name if frame else "",
        reply_frame=reply,
        object=table.object or "",
        start_bit=table.start_bit or 0,
        length=min(table.length or kind.bits, kind.bits),
        big_endian=table.byte_order == "big",
    )
