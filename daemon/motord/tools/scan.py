# SPDX-License-Identifier: Apache-2.0
"""Finds the units on an RS485 line. It only reads, one request at a time, each with a deadline.

A unit that answers a read of one register, even with an exception, is there. Then the readable
registers of each drive profile are read. The more of them answer within their ranges, the better
the profile fits.
"""

from __future__ import annotations

import itertools
import os
import select
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from motord.config.drives.load import list_profiles, load_profile
from motord.tools.scan_servos import received, servo_bound_s, servos
from motord_hal.base.errors import PortError, ProfileError
from motord_hal.ddsm import codec as ddsm
from motord_hal.drives.profile import DriveProfile, Register
from motord_hal.fieldbus.ports import DirectionSpec, LineSpec
from motord_hal.modbus.codec import (
    EXCEPTION_BYTES,
    UNIT_MAX,
    FrameError,
    Function,
    Reply,
    Request,
    build_request,
    character_bits,
    frame_time_s,
    parse_reply,
    reply_bytes,
    silent_interval_s,
)
from motord_hal.roboclaw import codec as roboclaw
from motord_hal.serial.port import OpenPort, SettingRefused, open_port

USUAL = (
    (115200, "none"), (9600, "none"), (19200, "even"), (19200, "none"), (9600, "even"),
    (57600, "none"), (38400, "none"), (115200, "even"), (1_000_000, "none"),
)  # fmt: skip
"""Usual baud rates and parities, the most common first. The default of MODBUS over Serial Line
V1.02, 2.5.1 is 19200, even."""
REPLY_WITHIN_S = 0.05
"""Longest time from the last byte of a request to the first of the reply: drives take a few
milliseconds, adapters up to 16."""
TRIES = 2
REGISTERS_A_PROFILE = 24
FITS_FROM = 0.5
DDSM_QUERY = 0x74
ROBOCLAW_UNITS = range(0x80, 0x88)
"""All addresses that a RoboClaw can have."""
ROBOCLAW_BATTERY = 24 << 8
"""Address of the main battery voltage, made from the number of the command that reads it."""
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Match:
    """A profile and the number of its registers that answered within their ranges."""

    profile: str
    fitting: int
    asked: int

    @property
    def part(self) -> float:
        return self.fitting / self.asked if self.asked else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A unit that answers."""

    unit: int
    baudrate: int
    parity: str
    kind: str
    """Kind of the line for a robot file: "modbus-rtu", "ddsm", "roboclaw", "feetech", "dynamixel"
    or "can"."""
    answer: str
    matches: tuple[Match, ...] = ()


@dataclass(slots=True)
class Asker:
    """Sends requests on an open port with one setting, and counts answers, echoes and bytes that
    were no answer."""

    port: OpenPort
    baudrate: int
    parity: str
    received_bytes: int = 0
    echoes: int = 0
    answers: int = 0
    turnaround_s: list[float] = field(default_factory=list)

    def ask(self, request: Request) -> Reply | None:
        """Send a Modbus request; return the answer to it. None: no valid answer came."""
        frame = build_request(request)
        return self._exchange(
            frame,
            (reply_bytes(request), EXCEPTION_BYTES),
            lambda reply: parse_reply(request, reply),
        )

    def ask_ddsm(self, unit: int) -> bytes | None:
        """Query the state of a drive with ten-byte frames (DDSM); return its answer. None: no valid
        answer came."""

        def parse(reply: bytes) -> bytes:
            if reply[0] != unit or not ddsm.sealed(reply):
                raise FrameError("another drive's")
            return reply

        return self._exchange(ddsm.build_request(unit, DDSM_QUERY, {}), (10,), parse)

    def ask_roboclaw(self, unit: int) -> tuple[int, ...] | None:
        """Read the battery voltage of a RoboClaw; return the raw value. None: no valid answer
        came."""
        request = Request(unit, Function.READ_HOLDING, ROBOCLAW_BATTERY, count=1)

        def parse(reply: bytes) -> tuple[int, ...]:
            try:
                return roboclaw.parse(request, reply)
            except roboclaw.PacketError as error:
                raise FrameError(str(error)) from error

        frame = roboclaw.build(request)
        return self._exchange(frame, (roboclaw.reply_size(request),), parse)

    def _exchange(
        self, frame: bytes, sizes: Sequence[int], parse: Callable[[bytes], Answer]
    ) -> Answer | None:
        bits = character_bits(self.parity, 1)
        time.sleep(silent_interval_s(self.baudrate, bits))
        self._drain()
        os.write(self.port.fd, frame)
        wire_s = frame_time_s(len(frame) + max(sizes), self.baudrate, self.parity, 1)
        end_s = time.monotonic() + wire_s + REPLY_WITHIN_S
        sent_s = time.monotonic() + frame_time_s(len(frame), self.baudrate, self.parity, 1)
        came = b""
        while (left_s := end_s - time.monotonic()) > 0:
            if not select.select([self.port.fd], [], [], left_s)[0]:
                break
            came += received(self.port)
            for size, start in ((size, start) for size in sizes for start in range(len(came))):
                part = came[start : start + size]
                if len(part) < size or (start == 0 and part == frame):
                    continue
                try:
                    answer = parse(part)
                except FrameError:
                    continue
                self.answers += 1
                self.echoes += came.startswith(frame)
                self.turnaround_s.append(max(time.monotonic() - sent_s, 0.0))
                return answer
        self.received_bytes += len(came)
        return None

    def _drain(self) -> None:
        while select.select([self.port.fd], [], [], 0)[0]:
            received(self.port)


def spec_of(port: str, baudrate: int, parity: str, direction: DirectionSpec) -> LineSpec:
    """Return the spec of a line for the scan, without joints."""
    return LineSpec(
        index=0, name="scan", kind="modbus-rtu", port=port, baudrate=baudrate, parity=parity,
        stop_bits=1, cycle_hz=1.0, gap_s=None, engine="rt", joints=(), watchdog_s=1.0,
        direction=direction,
    )  # fmt: skip


def bound_s(settings: Sequence[tuple[int, str]], units: Sequence[int]) -> float:
    """Return the longest time that requests to all units with all settings can take."""
    each_s = [
        len(units) * (frame_time_s(8 + 10 + 20, baudrate, parity, 1) + 2 * REPLY_WITHIN_S + 0.008)
        for baudrate, parity in settings
    ]
    unmarked = [baudrate for baudrate, parity in settings if parity == "none"]
    pings_s = [servo_bound_s(baudrate, units) for baudrate in unmarked]
    claws_s = len(unmarked) * len(ROBOCLAW_UNITS) * (REPLY_WITHIN_S + 0.02)
    return sum(each_s) + sum(pings_s) + claws_s


def scan(
    port: str,
    settings: Sequence[tuple[int, str]],
    units: Sequence[int],
    within_s: float,
    say: Callable[[str], None],
) -> Iterator[Found]:
    """Try the settings in turn and yield every unit that answers. After a setting with an answer
    stop, because a line has one baud rate. Raise PortError if the port cannot be used."""
    end_s = time.monotonic() + within_s
    for baudrate, parity in settings:
        say(f"{baudrate} baud, parity {parity}: units {units[0]} to {units[-1]}")
        try:
            opened = open_port(spec_of(port, baudrate, parity, DirectionSpec()))
        except SettingRefused as error:
            say(str(error))
            continue
        try:
            asker = Asker(opened, baudrate, parity)
            anybody = False
            for found in itertools.chain(_servos(asker, units, say), _roboclaws(asker, say)):
                anybody = True
                yield found
            for unit in () if anybody else (one for one in units if 0 < one <= UNIT_MAX):
                if time.monotonic() > end_s:
                    say(f"stopped after {within_s:g} s: --within-s looks on for longer")
                    return
                for found in _look(asker, unit, say):
                    anybody = True
                    yield found
            if asker.received_bytes and not anybody:
                say(f"{asker.received_bytes} bytes came, but no frame: baud rate or parity differ")
        finally:
            opened.close()
        if anybody:
            return


def _servos(asker: Asker, units: Sequence[int], say: Callable[[str], None]) -> Iterator[Found]:
    if asker.parity != "none":
        return
    for kind, unit, profile in servos(asker.port, asker.baudrate, units):
        say(f"servo {unit} answers")
        matches = (Match(profile, 1, 1),) if profile else ()
        yield Found(unit=unit, baudrate=asker.baudrate, parity=asker.parity, kind=kind,
                    answer="answers a ping", matches=matches)  # fmt: skip


def _roboclaws(asker: Asker, say: Callable[[str], None]) -> Iterator[Found]:
    for unit in ROBOCLAW_UNITS if asker.parity == "none" else ():
        if asker.ask_roboclaw(unit) is None:
            continue
        say(f"RoboClaw {unit} answers")
        names = [name for name, profile in _profiles() if profile.protocol == "roboclaw"]
        yield Found(unit=unit, baudrate=asker.baudrate, parity=asker.parity, kind="roboclaw",
                    answer="answers a RoboClaw's read",
                    matches=tuple(Match(name, 1, 1) for name in names))  # fmt: skip


def _look(asker: Asker, unit: int, say: Callable[[str], None]) -> Iterator[Found]:
    reply = asker.ask(Request(unit, Function.READ_HOLDING, 0, count=1))
    if reply is not None:
        answer = "answers" if reply.exception is None else f"refuses register 0 ({reply.exception})"
        say(f"unit {unit} {answer}: looking which drive it may be")
        yield Found(unit=unit, baudrate=asker.baudrate, parity=asker.parity, kind="modbus-rtu",
                    answer=answer, matches=fingerprint(asker, unit))  # fmt: skip
    elif asker.baudrate == 115200 and asker.parity == "none" and asker.ask_ddsm(unit) is not None:
        names = [name for name, profile in _profiles() if profile.protocol == "ddsm"]
        yield Found(unit=unit, baudrate=asker.baudrate, parity=asker.parity, kind="ddsm",
                    answer="answers in ten-byte frames",
                    matches=tuple(Match(name, 1, 1) for name in names))  # fmt: skip


def _profiles() -> Iterator[tuple[str, DriveProfile]]:
    for name, path in list_profiles().items():
        try:
            yield name, load_profile(path)
        except ProfileError:
            continue  # `motord drives` shows the error in it


def fingerprint(asker: Asker, unit: int) -> tuple[Match, ...]:
    """Return the profiles that fit the unit, the best first."""
    read: dict[tuple[int, int], tuple[int, ...] | None] = {}
    matches = []
    for name, profile in _profiles():
        if profile.protocol != "modbus-rtu":
            continue
        registers = [r for r in profile.registers.values() if "r" in r.access]
        asked = registers[:REGISTERS_A_PROFILE]
        fitting = sum(_fits(asker, unit, register, read) for register in asked)
        matches.append(Match(name, fitting, len(asked)))
    good = (match for match in matches if match.part >= FITS_FROM)
    return tuple(sorted(good, key=lambda match: (-match.part, -match.fitting)))


def _fits(
    asker: Asker,
    unit: int,
    register: Register,
    read: dict[tuple[int, int], tuple[int, ...] | None],
) -> bool:
    """Whether the register can be read and its value is within its range. `read` caches the values
    that were read."""
    place = register.address, register.type.words
    if place not in read:
        reply = None
        for _ in range(TRIES):
            request = Request(unit, Function.READ_HOLDING, place[0], count=place[1])
            reply = asker.ask(request)
            if reply is not None:
                break
        read[place] = None if reply is None or reply.exception is not None else reply.values
    words = read[place]
    if words is None:
        return False
    value = register.decode(words) * register.scale
    low = register.minimum is None or value >= register.minimum
    return low and (register.maximum is None or value <= register.maximum)


# --------------------------------------------------------------------------------------- direction
@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One method of switching the transceiver's direction, and its result."""

    name: str
    lines: tuple[str, ...]
    """Lines for the robot file that select this method."""
    asked: int = 0
    answers: int = 0
    echoes: int = 0
    turnaround_ms: float = 0.0
    problem: str = ""


ASKED = 10


def directions(
    port: str,
    baudrate: int,
    parity: str,
    unit: int,
    directions: Iterable[tuple[str, DirectionSpec, tuple[str, ...]]],
) -> Iterator[Trial]:
    """Try each method with ASKED reads of one unit, and yield its result."""
    for name, direction, lines in directions:
        try:
            opened = open_port(spec_of(port, baudrate, parity, direction))
        except PortError as error:
            yield Trial(name=name, lines=lines, problem=str(error))
            continue
        try:
            asker = Asker(opened, baudrate, parity)
            for _ in range(ASKED):
                asker.ask(Request(unit, Function.READ_HOLDING, 0, count=1))
        finally:
            opened.close()
        took_s = sorted(asker.turnaround_s)
        middle_ms = 1e3 * took_s[len(took_s) // 2] if took_s else 0.0
        yield Trial(name=name, lines=lines, asked=ASKED, answers=asker.answers,
                    echoes=asker.echoes, turnaround_ms=middle_ms)  # fmt: skip
