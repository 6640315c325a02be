# SPDX-License-Identifier: Apache-2.0
"""The tables of a drive profile that only a drive on a CAN bus has."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from motord.config.drives.parts import BOUND, WHOLE, Access, PartName, Scaled, Text, Unit
from motord.config.sections.section import Section, number
from motord_hal.drives.can_profile import EXTENDED_ID_MAX, NODE_MAX

FrameBytes = Annotated[Literal[0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], WHOLE]
"""Lengths of a frame's data: those of can_profile.SIZES_FD."""


class CanBus(Section):
    """[can]: the drive on a CAN bus, as delivered."""

    bitrate: int = number("bits a second", 10_000, 1_000_000, "1/s")
    node: int = number("the drive's node number", 0, NODE_MAX, "1")
    node_min: int = number("smallest node number that it can have", 0, NODE_MAX, "1", 0)
    node_max: int = number("largest node number that it can have", 0, NODE_MAX, "1")
    turnaround_s: float = number("longest time from a question to its answer", 1e-5, 1.0, "s")
    node_shift: int = number("identifier = id + node << node_shift", 0, 24, "1", 0)
    extended: bool = False
    """Identifiers have 29 bits."""
    fd: bool = False
    """Frames are CAN FD."""
    idle_setpoints: bool = True
    """Zero set-points are also sent while the drive is not armed."""
    hello: Text | None = None
    """The signal that motord requests until the drive is set up."""
    sync: Text | None = None
    """The frame that is sent once in each cycle, after the set-points."""


class DbcFile(Section):
    """[dbc]: the DBC file that describes the drive's frames and signals."""

    file: Text
    """Path of the DBC file, from the profile's folder."""
    drive: Text
    """The node of the file that stands for the drive."""
    node: int | None = number("the node number whose identifiers it has", 0, NODE_MAX, "1", None)


class EdsFile(Section):
    """[eds]: the electronic data sheet of a CANopen drive."""

    file: Text
    """Path of the data sheet, from the profile's folder."""


class CanFrame(Section):
    """[frame.NAME]: one kind of frame. With `dbc`, the DBC file has what is left out."""

    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [{"required": ["dbc"]}, {"required": ["id", "bytes", "sender", "source"]}]
        }
    )

    dbc: Text | None = None
    """Name of the frame's message in the DBC file."""
    id: int | None = number("identifier with node 0", 0, EXTENDED_ID_MAX, "1", None)
    bytes: FrameBytes | None = None
    """Length of the frame's data in bytes."""
    sender: Literal["motord", "drive"] | None = None
    """Which side sends it."""
    source: Text | None = None
    """The page or table where this can be checked."""
    node_shift: int | None = number("as in [can]", 0, 24, "1", None)
    extended: bool | None = None
    """Whether identifiers have 29 bits; by default as in [can]."""
    fd: bool | None = None
    """Whether frames are CAN FD; by default as in [can]."""
    begins: list[Annotated[int, Field(ge=-1, le=255)]] = Field(default_factory=list)
    """First bytes of the frame's data; -1: any byte."""
    ask: Text | None = None
    """How the frame is requested: "rtr", or the frame that requests it."""
    answers: Text | None = None
    """The frame of motord that the drive answers each time with this one."""
    period_s: float | None = number("how often the drive sends it unasked", 0.0005, 60.0, "s", None)
    silence_s: float | None = number(
        "without it for this long, the drive is unresponsive", 0.001, 60.0, "s", None
    )
    addressed: bool = True
    """Whether the identifier contains the node number."""
    short: bool = False
    """Whether an extended identifier that fits 11 bits is sent with 11."""
    node_byte: int | None = number("the byte of its data that holds the node", 0, 63, "1", None)


class ReservedIds(Section):
    """[reserved.NAME]: identifiers that are this drive's on the CAN bus beside its frames. No other
    drive of the bus may have them."""

    id: int = number("identifier with node 0", 0, EXTENDED_ID_MAX, "1")
    mask: int | None = number(
        "bits of the identifier that count; all if left out", 0, EXTENDED_ID_MAX, "1", None
    )
    sender: Literal["motord", "drive"] = "drive"
    """"drive": the drive may send them; "motord": it obeys them."""
    node_shift: int | None = number("as in [can]", 0, 24, "1", None)
    extended: bool | None = None
    """Whether these identifiers have 29 bits; by default as in [can]."""
    addressed: bool = True
    """Whether the identifier contains the node number."""
    source: Text
    """The page or table where this can be checked."""


class CanSignal(Scaled):
    """[signal.NAME]: a value in a frame. With `dbc`, the DBC file has what is left out."""

    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [{"required": ["dbc"]}, {"required": ["type", "start_bit", "source"]}]
        }
    )

    frame: Text
    """The frame that contains the signal."""
    dbc: Text | None = None
    """Name of the signal in the DBC file."""
    type: Literal["u8", "i8", "u16", "i16", "u32", "i32", "f32"] | None = None
    """Width and sign of the raw value."""
    start_bit: int | None = number("its first bit in the data", 0, 511, "1", None)
    length: int | None = number("bits; those of the type if left out", 1, 32, "1", None)
    byte_order: Literal["little", "big"] = "little"
    """Order of the signal's bytes; it also defines how start_bit is counted."""
    unit: Literal[Unit, "erpm"] = ""
    """Unit of the scaled value."""
    offset: float = number("what raw 0 means, in `unit`", -BOUND, BOUND, "1", 0.0)
    reply: Text | None = None
    """The frame in which a signal that is written is read."""
    object: PartName | None = None
    """The object that holds the same value."""
    source: Text | None = None
    """The page or table where this can be checked."""


class CanObject(Section):
    """[object.NAME]: an entry of the CANopen object dictionary, by expedited SDO transfer."""

    index: int = number("its index", 0x1000, 0xFFFF, "1")
    sub: int = number("its sub-index", 0, 255, "1", 0)
    type: Literal["u8", "i8", "u16", "i16", "u32", "i32"] | None = None
    """Width and sign of the raw value; the data sheet of [eds] gives them, too."""
    access: Literal["r", "rw"] = "rw"
    """What motord may do with the entry: read, or read and write."""
    scale: float = number("`unit` for each 1 of the raw value", -BOUND, BOUND, "1", 1.0)
    unit: Unit = ""
    """Unit of the scaled value."""
    default: int = number("raw value at power-up", -(1 << 31), (1 << 32) - 1, "1", 0)
    source: Text | None = None
    """The page or table where this can be checked."""


__all__ = [
    "Access",
    "CanBus",
    "CanFrame",
    "CanObject",
    "CanSignal",
    "DbcFile",
    "EdsFile",
    "ReservedIds",
]
