# SPDX-License-Identifier: Apache-2.0
"""Tables of check sums."""

from __future__ import annotations


def reflected_table(polynomial: int) -> tuple[int, ...]:
    """By a byte, of a CRC whose bits go low first; the polynomial in that order."""
    rows = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ polynomial if crc & 1 else crc >> 1
        rows.append(crc)
    return tuple(rows)
