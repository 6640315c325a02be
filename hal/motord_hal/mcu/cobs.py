# SPDX-License-Identifier: Apache-2.0
"""Consistent overhead byte stuffing: removes zeros from data, so that zeros can separate frames.

Source: Cheshire & Baker, Consistent Overhead Byte Stuffing, IEEE/ACM Transactions on Networking
7(2), 1999.
"""

from __future__ import annotations

_BLOCK_MAX = 254
"""Most bytes behind one code byte. The code 255 means that no zero follows them."""


def encode(data: bytes) -> bytes:
    """Return the data without zeros: one byte longer, and one more for each 254."""
    out = bytearray()
    for number, run in enumerate(runs := data.split(b"\0")):
        while len(run) >= _BLOCK_MAX:
            out += bytes((_BLOCK_MAX + 1,)) + run[:_BLOCK_MAX]
            run = run[_BLOCK_MAX:]
            if not run and number == len(runs) - 1:
                return bytes(out)
        out += bytes((len(run) + 1,)) + run
    return bytes(out)


def decode(data: bytes) -> bytes:
    """Return the decoded bytes. Raises ValueError for bytes that `encode` never makes."""
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        block = data[at + 1 : at + code]
        if code == 0 or len(block) != code - 1 or 0 in block:
            raise ValueError(f"byte {at}: no block of {code}")
        out += block
        at += code
        if code <= _BLOCK_MAX and at < len(data):
            out.append(0)
    return bytes(out)
