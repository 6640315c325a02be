# SPDX-License-Identifier: Apache-2.0
"""The guided set-up behind `motord init`: finds the drives, asks what it cannot know."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motord.commission.hardware import Place, place_of, places
from motord.commission.person import Failed, Person
from motord.commission.robot_text import Answers, Wheel
from motord.config.drives.load import find_profile, list_profiles, load_profile
from motord.tools.scan import USUAL, Found, scan
from motord_hal.base.errors import HalError, ProfileError
from motord_hal.drives.profile import DriveProfile

SIMULATED = "simulated"
LINE_KINDS = {
    "modbus-rtu": "modbus-rtu", "ddsm": "ddsm", "can": "can", "mcu-frame": "mcu",
    "ascii": "ascii", "roboclaw": "roboclaw", "feetech": "feetech", "dynamixel": "dynamixel",
    "hoverboard": "hoverboard", "hoverboard-steer": "hoverboard", "sabertooth": "sabertooth",
}  # fmt: skip
"""Protocol of a profile → kind of its line."""
FD_BITRATE = 5_000_000
"""What CAN FD transceivers of drives carry."""
RADIUS_USUAL_M, TRACK_USUAL_M = (0.02, 0.4), (0.08, 3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """Answers that came as options; None: ask."""

    name: str | None = None
    place: str | None = None
    drive: str | None = None
    base: str | None = None
    wheel_radius_m: float | None = None
    track_m: float | None = None
    linear_m_s: float | None = None
    angular_rad_s: float | None = None
    gear_ratio: float | None = None
    counts_per_turn: int | None = None
    full_duty_rad_s: float | None = None
    baudrate: int | None = None
    parity: str | None = None
    left: tuple[int, int] | None = None
    """Unit and channel."""
    right: tuple[int, int] | None = None
    scan: bool = True
    units: range = range(1, 17)
    scan_within_s: float = 60.0


def set_up(person: Person, given: Given, file: Path) -> Answers:
    """Ask everything. Raises Failed, Aborted."""
    place = _place(person, given)
    found = _scanned(person, given, place)
    drive, profile = _drive(person, given, found, place)
    name = given.name or person.text("What is the robot's name?", _name_of(file))
    base = given.base or person.choose(
        "Two driven sides with casters, or four driven wheels that scrub?", ["differential", "skid"]
    )
    radius_m = _plausible(
        person, given.wheel_radius_m, "Radius of a loaded wheel, from axle to floor?",
        RADIUS_USUAL_M, (0.005, 5.0),
        lambda value: f"{value:g} m: a wheel of {2 * value:.3g} m across?",
    )  # fmt: skip
    track_m = _plausible(
        person, given.track_m, "Distance from the middle of a left tyre to that of a right one?",
        (max(TRACK_USUAL_M[0], radius_m), TRACK_USUAL_M[1]), (0.02, 20.0),
        lambda value: f"{100 * value:.3g} cm between left and right wheels?",
    )  # fmt: skip
    linear_m_s = _asked(
        person, given.linear_m_s, "Top speed? 0.5 is a slow walk", "m/s", 0.01, 10.0
    )
    angular_rad_s = _asked(
        person, given.angular_rad_s, "Fastest turn on the spot? 1.0 is a turn in six seconds",
        "rad/s", 0.01, 20.0,
    )  # fmt: skip
    more = _joint_keys(person, given, profile)
    return Answers(
        name=name,
        base=base,
        wheel_radius_m=radius_m,
        track_m=track_m,
        linear_m_s=linear_m_s,
        angular_rad_s=angular_rad_s,
        line=_line(given, place, found, profile, file),
        drive=drive,
        wheels=_wheels(person, given, found, profile, more),
    )


# ------------------------------------------------------------------------------- where and what
def _place(person: Person, given: Given) -> Place | None:
    """None: simulated."""
    name = given.place
    if name is None:
        found = places()
        for number, one in enumerate(found, 1):
            person.show(f"  {number}  {one.name}  ({one.about})")
        number = len(found) + 1
        person.show(f"  {number}  {SIMULATED}: no hardware, to try motord")
        numbers = [str(one) for one in range(1, number + 1)]
        answer = int(person.choose("Where are the drives connected?", numbers))
        if answer <= len(found):
            return found[answer - 1]
        name = SIMULATED
    return None if name == SIMULATED else place_of(name)


def _scanned(person: Person, given: Given, place: Place | None) -> list[Found]:
    """Who answers on a serial port. The scan only reads."""
    if place is None or place.kind != "serial" or not given.scan:
        return []
    settings = [
        one for one in USUAL if given.baudrate in (None, one[0]) and given.parity in (None, one[1])
    ] or [(given.baudrate or 115200, given.parity or "none")]
    found: list[Found] = []
    try:
        for one in scan(place.name, settings, given.units, given.scan_within_s, person.progress):
            matches = ", ".join(match.profile for match in one.matches[:3]) or "no profile fits"
            person.show(f"  unit {one.unit} at {one.baudrate} {one.parity}: {matches}")
            found.append(one)
            if person.aborted():
                raise Failed("the scan was ended: nothing was written")
    except HalError as error:
        raise Failed(f"{place.name}: {error}") from error
    if not found:
        person.show("no unit answers: A and B swapped? power, ground, unit? (docs/rs485.md)")
    return found


def _drive(
    person: Person, given: Given, found: list[Found], place: Place | None
) -> tuple[str, DriveProfile]:
    proposed = next((one.matches[0].profile for one in found if one.matches), "")
    name = given.drive
    if name is None:
        if not proposed:
            person.show(f"drive profiles: {', '.join(_known(place))}")
        name = person.text("Which drive profile?", proposed)
    try:
        profile = find_profile(name)
    except ProfileError as error:
        raise Failed(str(error)) from error
    _require_match(person, given, found, name)
    if not _fits(profile, place):
        kind = place.kind if place else SIMULATED
        raise Failed(f'drive "{name}" speaks {profile.protocol}, which is not for {kind}')
    return name, profile


def _require_match(person: Person, given: Given, found: list[Found], name: str) -> None:
    """The registers that answered have to be those of the profile."""
    for one in found:
        fitting = [match.profile for match in one.matches]
        if not fitting or name in fitting:
            continue
        text = f"unit {one.unit} answers as {', '.join(fitting[:3])} does, not as {name}"
        if given.drive is not None:
            raise Failed(f"{text}: leave --drive out, or give --no-scan")
        if not person.confirm(f"{text}. Use {name} all the same?"):
            raise Failed(f"{text}: nothing was written")


def _known(place: Place | None) -> Iterator[str]:
    for name, path in list_profiles().items():
        with contextlib.suppress(ProfileError):  # a file of an extra that is not installed
            if _fits(load_profile(path), place):
                yield name


def _fits(profile: DriveProfile, place: Place | None) -> bool:
    kind = {"can": "can", "pwm": "pwm"}.get(profile.protocol, "serial")
    return kind == (place.kind if place else "serial") or (place is None and kind == "can")


# ------------------------------------------------------------------------------------- the joints
def _wheels(
    person: Person,
    given: Given,
    found: list[Found],
    profile: DriveProfile,
    more: Mapping[str, Any],
) -> tuple[Wheel, ...]:
    channels = sorted(profile.channels)
    units = [one.unit for one in found] or [1, 2]
    if len(channels) > 1:
        usual = ((units[0], channels[0]), (units[0], channels[1]))
    else:
        usual = (
            (units[0], channels[0]),
            (units[1] if len(units) > 1 else units[0] + 1, channels[0]),
        )
    at = []
    for side, option, proposed in zip(
        ("left", "right"), (given.left, given.right), usual, strict=True
    ):
        at.append(option or _unit(person, side, proposed))
    # motors that face each other turn opposite ways; spin shows whether these do
    return tuple(
        Wheel(name=side, side=side, unit=unit, channel=channel, inverted=side == "right", more=more)
        for side, (unit, channel) in zip(("left", "right"), at, strict=True)
    )


def _unit(person: Person, side: str, proposed: tuple[int, int]) -> tuple[int, int]:
    text = person.text(
        f"Unit and channel of the {side} wheel's drive, as 1.2?", f"{proposed[0]}.{proposed[1]}"
    )
    return unit_and_channel(text)


def unit_and_channel(text: str) -> tuple[int, int]:
    """`1.2`, or `1` for the first channel. Raises Failed."""
    unit, _, channel = text.partition(".")
    if not unit.isascii() or not unit.isdigit() or not (channel or "1").isdigit():
        raise Failed(f'"{text}" is no unit and channel, as 1.2')
    return int(unit), int(channel or 1)


def _joint_keys(person: Person, given: Given, profile: DriveProfile) -> dict[str, Any]:
    keys: dict[str, Any] = {}
    channel = next(iter(profile.channels.values()))
    if channel.torque_setpoint is not None:
        raise Failed(
            f'drive "{profile.name}" takes a torque, and motord needs the gains of its speed loop: '
            "begin with config/robots/cia402-torque.toml (motord robots cia402-torque)"
        )
    gear_ratio = _asked(
        person, given.gear_ratio, "Motor turns for a wheel turn? 1 for a hub motor", "1", 0.001, 1e4
    )
    if gear_ratio != 1.0:
        keys["gear_ratio"] = gear_ratio
    if channel.duty_setpoint is not None:
        keys["full_duty_rad_s"] = _asked(
            person, given.full_duty_rad_s, "Speed of a wheel at full duty?", "rad/s", 0.1, 1000.0
        )
    counts = given.counts_per_turn
    if profile.counter_bits and not profile.counts_per_turn and counts is None:
        counts = round(
            person.number("Encoder counts for a motor turn (0: no encoder)?", "1", 0, 1 << 30)
        )
    if counts is not None:
        keys["counts_per_turn"] = counts
    return keys


def _line(
    given: Given, place: Place | None, found: list[Found], profile: DriveProfile, file: Path
) -> dict[str, Any]:
    kind = LINE_KINDS.get(profile.protocol)
    if kind is None:
        raise Failed(
            f'drive "{profile.name}" is on pins: begin with config/robots/pi5-bts7960.toml '
            "(motord robots pi5-bts7960) and docs/pwm.md"
        )
    keys: dict[str, Any]
    if kind == "can":
        channel = place.name if place else "can0"
        bitrate = given.baudrate or profile.baudrate
        keys = {"kind": "can", "interface": "socketcan", "channel": channel, "bitrate": bitrate}
        if profile.can is not None and any(frame.fd for frame in profile.can.frames.values()):
            keys["data_bitrate"] = FD_BITRATE
        return keys
    port = place.name if place else str(simulated_ports(file) / "main")
    scanned = found[0] if found else None
    keys = {"kind": scanned.kind if scanned else kind, "port": port}
    keys["baudrate"] = given.baudrate or (scanned.baudrate if scanned else profile.baudrate)
    if kind == "modbus-rtu":
        keys["parity"] = given.parity or (scanned.parity if scanned else profile.parity)
        keys["stop_bits"] = profile.stop_bits
    return keys


def simulated_ports(file: Path) -> Path:
    """Where `motord simulate --link-dir` puts the ports of this robot."""
    return file.absolute().with_suffix(".ports")


# ------------------------------------------------------------------------------------------ numbers
def _asked(
    person: Person, given: float | None, question: str, unit: str, low: float, high: float
) -> float:
    if given is None:
        return person.number(question, unit, low, high)
    if not low <= given <= high:
        raise Failed(f"{question} {given:g} is out of range ({low:g} to {high:g} {unit})")
    return given


def _plausible(
    person: Person,
    given: float | None,
    question: str,
    usual: tuple[float, float],
    span: tuple[float, float],
    aloud: Callable[[float], str],
) -> float:
    """A length; one that is not usual is asked about. An option is believed, but named."""
    while True:
        value = _asked(person, given, question, "m", *span)
        if usual[0] <= value <= usual[1]:
            return value
        if given is not None:
            person.show(aloud(value))
            return value
        if person.confirm(aloud(value)):
            return value


def _name_of(file: Path) -> str:
    stem = "".join(one if one.isalnum() or one in "-_" else "-" for one in file.stem)
    return stem if stem[:1].isalpha() else f"robot-{stem}"
