# SPDX-License-Identifier: Apache-2.0
"""Conversion of values to a drive's frames and back, and the time a frame holds the CAN bus.
Pure."""

from __future__ import annotations

from collections.abc import Mapping

from motord_hal.drives.can_profile import Frame, Signal

# ISO 11898-1, 10.4: fields of a classic frame that are stuffed, beside the data
_STUFFED_BITS = 34
"""Bits of start, identifier, RTR, IDE, r0, DLC, CRC: 1 + 11 + 1 + 1 + 1 + 4 + 15."""
_EXTENDED_MORE_BITS = 20
"""Further bits of an extended frame: 18 bits of identifier, SRR and r1."""
_FIXED_BITS = 13
"""Bits without stuffing: CRC delimiter, ACK and its delimiter, end of frame, intermission: 1 + 2 +
7 + 3."""
_FD_HEAD_BITS = 17
"""Bits of start, identifier, RRS, IDE, FDF, res, BRS: 1 + 11 + 5 (ISO 11898-1, 10.4.2.3)."""
_FD_CONTROL_BITS = 5
"""Bits of ESI and DLC."""
_FD_STUFF_COUNT_BITS = 4
_FD_LONG_BYTES = 16
"""Longer frames have a CRC of 21 bits, others one of 17."""


def build(frame: Frame, signals: tuple[Signal, ...], raw: Mapping[str, int]) -> bytes:
    """Return the data of a frame: its `begins`, with its signals written over it. A signal that is
    not in `raw` has its default."""
    data = bytearray(frame.begins.ljust(frame.size_bytes, b"\x00"))
    for signal in signals:
        signal.insert(data, raw.get(signal.name, signal.default))
    return bytes(data)


def parse(frame: Frame, signals: tuple[Signal, ...], data: bytes) -> dict[str, int] | None:
    """Return signal → raw value; None: the data belong to another frame, or are cut short."""
    if not frame.matches(data):
        return None
    whole = data[: frame.size_bytes]
    return {signal.name: signal.extract(whole) for signal in signals}


def frame_bits(size_bytes: int, *, extended: bool) -> int:
    """Return the bits of a classic frame with its intermission and the most stuff bits possible,
    one after each four (Tindell, Burns & Wellings, Calculating Controller Area Network message
    response times, 1995; corrected by Davis et al., 2007). 8 bytes: 135, extended 160."""
    stuffed = _STUFFED_BITS + _EXTENDED_MORE_BITS * extended + 8 * size_bytes
    return stuffed + (stuffed - 1) // 4 + _FIXED_BITS


def frame_time_s(
    frame: Frame, bitrate: int, data_bitrate: int | None, *, remote: bool = False
) -> float:
    """Return the longest time that a frame holds the CAN bus; `remote`: the remote frame that
    requests it."""
    if not frame.fd:
        size_bytes = 0 if remote else frame.size_bytes
        return frame_bits(size_bytes, extended=frame.extended) / bitrate
    head = _FD_HEAD_BITS + _EXTENDED_MORE_BITS * frame.extended
    head += (head - 1) // 4
    dynamic = _FD_CONTROL_BITS + 8 * frame.size_bytes
    dynamic += (dynamic - 1) // 4
    crc = _FD_STUFF_COUNT_BITS + (21 if frame.size_bytes > _FD_LONG_BYTES else 17)
    crc += -(-crc // 4) + 1  # fixed stuff bits: one before it, one after each four
    return (head + _FIXED_BITS) / bitrate + (dynamic + crc) / (data_bitrate or bitrate)
