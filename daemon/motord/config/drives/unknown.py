# SPDX-License-Identifier: Apache-2.0
"""What a drive profile may list as unknown, and what of it keeps the drive from being used."""

from __future__ import annotations

from types import MappingProxyType

from motord.config.drives.problems import Problems
from motord_hal.drives.profile import DriveProfile

UNKNOWN = MappingProxyType(
    {
        "serial": "baud rate, parity, stop bits, address or writing function: [serial]",
        "sign": "whether the speed set-point is signed, or a magnitude with a direction",
        "order": "the order of the bytes and words of the speed",
        "scale": "the speed that a raw 1 means",
        "range": "the fastest speed: minimum and maximum of the set-point",
        "start": "whether writing the speed alone starts the motor",
        "enable": "the register that gives the motor its power, with its values",
        "velocity": "the measured speed: its register, width, sign and unit",
        "watchdog": "whether the drive stops by itself without commands, and how that is set",
        "source": "where these facts are written down",
    }
)
"""Fact → what it is."""
BLOCKING = frozenset(UNKNOWN) - {"velocity", "watchdog", "source"}
"""Facts without which it is open how fast, or when, the motor turns."""


def check_unknown(profile: DriveProfile, problems: Problems) -> None:
    """Add a problem for each unknown fact without which the drive must not be used."""
    for index, fact in enumerate(profile.unknown):
        if fact in BLOCKING:
            text = f'"{fact}" is unknown ({UNKNOWN[fact]}): look it up, write it into this file, '
            problems.add(f"unknown[{index}]", f"{text}and take it off this list")
