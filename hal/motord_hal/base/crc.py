# SPDX-License-Identifier: Apache-2.0
"""Tables of CRC check sums."""

from __future__ import annotations


def reflected_table(polynomial: int) -> tuple[int, ...]:
    """Return the table by byte for a CRC with the low bit first. `polynomial` is in the same
    order."""
    rows = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ polynomial if crc & 1 else crc >> 1
        rows.append(crc)
    return tuple(rows)
