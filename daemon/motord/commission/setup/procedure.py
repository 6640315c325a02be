# SPDX-License-Identifier: Apache-2.0
"""The guided set-up of `motord init`: it finds the drives; a person answers the other questions."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from motord.commission.person import Failed, Person
from motord.commission.setup.base import STRAFING, asked, base_of, unit_and_channel, wheels_of
from motord.commission.setup.hardware import (
    FD_BITRATE,
    USUAL_BITRATE,
    Place,
    can_address,
    carries_fd,
    interface_bit_rate,
    place_of,
    places,
)
from motord.commission.setup.robot_text import Answers
from motord.commission.setup.steered import LINE, STEERED, Steering, steered_wheels
from motord.config.drives.load import find_profile, list_profiles, load_profile
from motord.tools.scan import USUAL, Found, scan
from motord.tools.scan_can import scan_can
from motord_hal.base.errors import HalError, ProfileError
from motord_hal.drives.profile import DriveProfile

__all__ = ["Given", "set_up", "simulated_ports", "unit_and_channel"]

SIMULATED, SAME = "simulated", "same"
LINE_KINDS = {
    "modbus-rtu": "modbus-rtu", "ddsm": "ddsm", "can": "can", "mcu-frame": "mcu",
    "ascii": "ascii", "roboclaw": "roboclaw", "feetech": "feetech", "dynamixel": "dynamixel",
    "hoverboard": "hoverboard", "hoverboard-steer": "hoverboard", "sabertooth": "sabertooth",
}  # fmt: skip
"""Kind of the line, by the protocol of a profile."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """Answers that were given as options; None: the person is asked."""

    name: str | None = None
    place: str | None = None
    drive: str | None = None
    base: str | None = None
    wheel_radius_m: float | None = None
    track_m: float | None = None
    wheelbase_m: float | None = None
    radius_m: float | None = None
    """Distance from the middle of an omni base to its wheels."""
    wheel_count: int | None = None
    """Number of wheels of an omni or swerve base."""
    linear_m_s: float | None = None
    lateral_m_s: float | None = None
    angular_rad_s: float | None = None
    gear_ratio: float | None = None
    counts_per_turn: int | None = None
    full_duty_rad_s: float | None = None
    baudrate: int | None = None
    parity: str | None = None
    left: tuple[int, int] | None = None
    """Unit and channel."""
    right: tuple[int, int] | None = None
    addresses: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Unit and channel by the name of a joint."""
    steered: str | None = None
    """The steered axle of a car."""
    driven: str | None = None
    """Which motors drive a car (motord.commission.setup.steered.DRIVEN)."""
    steering_count: int | None = None
    """How many drives steer a car."""
    steering_drive: str | None = None
    steering_place: str | None = None
    steering_max_rad: float | None = None
    steering_rad_s: float | None = None
    steering_gear_ratio: float | None = None
    zero_count: int | None = None
    """Counter value straight ahead of the drives that steer; None: the middle of their range."""
    scan: bool = True
    units: range = range(1, 17)
    scan_within_s: float = 60.0


def set_up(person: Person, given: Given, file: Path) -> Answers:
    """Ask all questions. Raises Failed, Aborted."""
    place = _place(person, given)
    if given.drive is not None:
        _require_rolls(_profile(given.drive, place), file)  # before a scan that takes a minute
    found = _scanned(person, given, place)
    drive, profile = _drive(person, given, found, place)
    _require_rolls(profile, file)
    name = given.name or person.text("What is the robot's name?", _name_of(file))
    base = base_of(person, given)
    linear_m_s = asked(person, given.linear_m_s, "Top speed? 0.5 is a slow walk", "m/s", 0.01, 10.0)
    lateral_m_s = None
    if base["kind"] in STRAFING:
        lateral_m_s = asked(person, given.lateral_m_s, "Top speed sideways?", "m/s", 0.01, 10.0)
    angular_rad_s = asked(
        person, given.angular_rad_s, "Fastest turn? 1.0 is a turn in six seconds",
        "rad/s", 0.01, 20.0,
    )  # fmt: skip
    more = _joint_keys(person, given, profile)
    units = [one.unit for one in found if name_fits(one, drive)]
    line, lines = _line(given, place, found, profile, file), {}
    channels = sorted(profile.channels)
    if base["kind"] in STEERED:
        steering, own = _steering(person, given, place, drive, line, file)
        lines = {} if own is None else {steering.line: own}
        wheels = steered_wheels(person, given, base, units, channels, more, steering)
    else:
        wheels = wheels_of(person, given, base, units, channels, more)
    return Answers(
        name=name,
        base=base,
        linear_m_s=linear_m_s,
        angular_rad_s=angular_rad_s,
        lateral_m_s=lateral_m_s,
        line=line,
        other_lines=lines,
        drive=drive,
        wheels=wheels,
    )


# ------------------------------------------------------------------------------- where and what
def _place(person: Person, given: Given) -> Place | None:
    """Return where the drives are connected; None: they are simulated."""
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
    """Return the drives that answer there. The scan only reads."""
    if place is None or place.kind == "pwm" or not given.scan:
        return []
    try:
        found = _on_bus(person, given, place) if place.kind == "can" else []
        for one in _on_port(person, given, place) if place.kind == "serial" else ():
            found.append(one)
            _show_found(person, one)
            if person.aborted():
                raise Failed("the scan was ended: nothing was written")
    except HalError as error:
        raise Failed(f"{place.name}: {error}") from error
    if not found and place.kind == "serial":
        person.show("no unit answers: A and B swapped? power, ground, unit? (docs/rs485.md)")
    elif not found:
        person.show("no node answers: bit rate, termination, power? (docs/can.md)")
    return found


def _on_port(person: Person, given: Given, place: Place) -> Iterator[Found]:
    person.show(
        "The scan sends reads. A controller that takes each byte as a speed (Sabertooth in "
        "simplified serial mode) would turn: keep its wheels off the ground."
    )
    settings = [
        one for one in USUAL if given.baudrate in (None, one[0]) and given.parity in (None, one[1])
    ] or [(given.baudrate or 115200, given.parity or "none")]
    return scan(place.name, settings, given.units, given.scan_within_s, person.progress)


def _on_bus(person: Person, given: Given, place: Place) -> list[Found]:
    address = can_address(place.name)
    bitrate = given.baudrate or interface_bit_rate(address) or USUAL_BITRATE
    data_bitrate = FD_BITRATE if carries_fd(address) else None
    found = scan_can(address, bitrate, data_bitrate, person.progress, person.aborted)
    if person.aborted():
        raise Failed("the scan was ended: nothing was written")
    for one in found:
        _show_found(person, one)
    return found


def _show_found(person: Person, one: Found) -> None:
    matches = ", ".join(match.profile for match in one.matches[:3]) or "no profile fits"
    if one.kind == "can":
        person.show(f"  node {one.unit}: {one.answer}: {matches}")
    else:
        person.show(f"  unit {one.unit} at {one.baudrate} {one.parity}: {matches}")


def _drive(
    person: Person, given: Given, found: list[Found], place: Place | None
) -> tuple[str, DriveProfile]:
    proposed = next((one.matches[0].profile for one in found if one.matches), "")
    name = given.drive
    if name is None:
        if not proposed:
            person.show(f"drive profiles: {', '.join(_known(place))}")
        name = person.text("Which drive profile?", proposed)
    profile = _profile(name, place)
    _require_match(person, given, found, name)
    return name, profile


def _profile(name: str, place: Place | None) -> DriveProfile:
    """Load a profile. Raises Failed if it does not exist or does not fit the place."""
    try:
        profile = find_profile(name)
    except ProfileError as error:
        raise Failed(str(error)) from error
    if not _fits(profile, place):
        kind = place.kind if place else SIMULATED
        raise Failed(f'drive "{name}" speaks {profile.protocol}, which is not for {kind}')
    return profile


_EXAMPLE_ON_PINS = {
    "tb6612fng": "pi4-encoders",
    "rc-servo": "ackermann-servo-pwm",
    "servo-pulse": "ackermann-servo-pwm",
}
"""Examples for drives that the usual example does not have."""


def _require_rolls(profile: DriveProfile, file: Path) -> None:
    """Check that the drive rolls a wheel and needs no more than these answers. Raises Failed, with
    the example to begin with."""
    _require_no_pins(profile, file)
    if takes_positions(profile):
        raise Failed(f'drive "{profile.name}" takes positions: it steers a wheel, and rolls none')
    if next(iter(profile.channels.values())).torque_setpoint is not None:
        raise Failed(
            f'drive "{profile.name}" takes a torque, and motord needs the gains of its speed loop: '
            f"motord robots cia402-torque > {file}, change it to your drives, then motord check "
            f"{file}"
        )


def _require_no_pins(profile: DriveProfile, file: Path) -> None:
    if profile.protocol not in LINE_KINDS:
        example = _EXAMPLE_ON_PINS.get(profile.name, "pi5-bts7960")
        raise Failed(
            f'drive "{profile.name}" is on pins, and this does not ask which: motord robots '
            f"{example} > {file}, change its pins (docs/pwm.md), then motord check {file}"
        )


def name_fits(found: Found, drive: str) -> bool:
    """Return whether it may be such a drive: another device on the CAN bus is no wheel."""
    return not found.matches or drive in [match.profile for match in found.matches]


def _require_match(person: Person, given: Given, found: list[Found], name: str) -> None:
    """Check that the registers that answered are those of the profile. Raises Failed."""
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
def _joint_keys(person: Person, given: Given, profile: DriveProfile) -> dict[str, Any]:
    keys: dict[str, Any] = {}
    channel = next(iter(profile.channels.values()))
    gear_ratio = asked(
        person, given.gear_ratio, "Motor turns for a wheel turn? 1 for a hub motor", "1", 0.001, 1e4
    )
    if gear_ratio != 1.0:
        keys["gear_ratio"] = gear_ratio
    if channel.duty_setpoint is not None:
        keys["full_duty_rad_s"] = asked(
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


def _steering(
    person: Person,
    given: Given,
    place: Place | None,
    drive: str,
    line: Mapping[str, Any],
    file: Path,
) -> tuple[Steering, dict[str, Any] | None]:
    """Request the drives that steer. The second result is their line; None: they share one."""
    where = given.steering_place or (
        SAME if place is None or given.steering_drive is not None
        else person.text("Where are the drives that steer connected?", SAME)
    )  # fmt: skip
    other = place if where == SAME else None if where == SIMULATED else place_of(where)
    name = given.steering_drive
    if name is None:
        known = [one for one in _known(other) if takes_positions(find_profile(one))]
        person.show(f"drive profiles that steer: {', '.join(known)}")
        proposed = f"{drive}-position"
        name = person.text("Which one?", proposed if proposed in known else "")
    profile = _profile(name, other)
    if not takes_positions(profile):
        raise Failed(f'drive "{name}" takes no positions, so it steers no wheel')
    _require_no_pins(profile, file)
    kind = LINE_KINDS[profile.protocol]
    if where == SAME and kind == line["kind"]:
        return Steering(drive=name, profile=profile, line="main"), None
    if where == SAME and place is not None:
        raise Failed(
            f'drive "{name}" speaks {profile.protocol}, and the line of {drive} does not: name the '
            "port of the drives that steer (--steering-at)"
        )
    own = _line(replace(given, baudrate=None, parity=None), other, [], profile, file, LINE)
    return Steering(drive=name, profile=profile, line=LINE), own


def takes_positions(profile: DriveProfile) -> bool:
    """Return whether the set-point of these drives is an angle."""
    return next(iter(profile.channels.values())).position_setpoint is not None


def _line(
    given: Given,
    place: Place | None,
    found: list[Found],
    profile: DriveProfile,
    file: Path,
    name: str = "main",
) -> dict[str, Any]:
    kind = LINE_KINDS[profile.protocol]
    keys: dict[str, Any]
    if kind == "can":
        address = can_address(place.name) if place else f"unix:{simulated_ports(file) / name}"
        interface, _, channel = address.partition(":")
        bitrate = given.baudrate or (found[0].baudrate if found else profile.baudrate)
        keys = {"kind": "can", "interface": interface, "channel": channel, "bitrate": bitrate}
        if profile.can is not None and any(frame.fd for frame in profile.can.frames.values()):
            keys["data_bitrate"] = FD_BITRATE
        return keys
    port = place.name if place else str(simulated_ports(file) / name)
    scanned = found[0] if found else None
    keys = {"kind": scanned.kind if scanned else kind, "port": port}
    keys["baudrate"] = given.baudrate or (scanned.baudrate if scanned else profile.baudrate)
    if kind == "modbus-rtu":
        keys["parity"] = given.parity or (scanned.parity if scanned else profile.parity)
        keys["stop_bits"] = profile.stop_bits
    return keys


def simulated_ports(file: Path) -> Path:
    """Return where `motord simulate --link-dir` puts the ports of this robot."""
    return file.absolute().with_suffix(".ports")


def _name_of(file: Path) -> str:
    stem = "".join(one if one.isalnum() or one in "-_" else "-" for one in file.stem)
    return stem if stem[:1].isalpha() else f"robot-{stem}"
