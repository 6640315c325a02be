# SPDX-License-Identifier: Apache-2.0
"""Opening of the channels and GPIO lines for the pins that a robot file names. Errors name the
joint, the pin and the remedy."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from motord_hal.base.errors import PortError, ProfileError
from motord_hal.drives.profile import BRIDGE_MODES, Bridge
from motord_hal.encoder.board import board_encoder
from motord_hal.encoder.counter import open_counter
from motord_hal.encoder.edges import open_edges
from motord_hal.fieldbus.ports import BoardEncoder, CounterEncoder, JointSpec, LineSpec
from motord_hal.gpio.lines import Wanted, request_inputs, request_outputs
from motord_hal.gpio.pinmux import not_muxed, pwm_step
from motord_hal.pwm.sysfs import (
    Channel,
    ChipAbsent,
    device_of,
    find_chip,
    made_in_software,
    open_channel,
)
from motord_hal.realtime.pwm import EncoderConfig, Pin

FAULT = "fault"
"""Pin of a bridge that signals a fault: an input."""
PUMP = "pump"
"""Output that changes with every cycle while the motor may move: a charge pump or a watchdog behind
it removes the power when any thread hangs or the process dies."""
SOFTWARE_PERIOD_MIN_NS = 1_000_000
"""Shortest period of pulses made in software. Each edge is an interrupt: 2000 a second for a pin
are enough."""
_LOW = dict.fromkeys(BRIDGE_MODES, (0.0, 0.0))
_CHANNEL = re.compile(r"pwm(\d+)")


@dataclass(frozen=True, slots=True)
class Place:
    """Location of a pin."""

    joint: int
    """Index of the joint on the line."""
    pin: str
    purpose: str
    channel: int | None
    """Channel of the PWM chip; None: a GPIO line."""
    gpio: str
    inverted: bool


def servo_range_rad(joint: JointSpec) -> float:
    """Return the joint's angle, to either side, for the longest and the shortest pulse; 0: its
    drive takes duties."""
    channel = joint.profile.channels[joint.channel]
    if channel.position_setpoint is None:
        return 0.0
    most_rad = joint.profile.registers[channel.position_setpoint].si_limits[1]
    return most_rad / joint.gear_ratio


def bridge_of(joint: JointSpec) -> Bridge:
    """Return the joint's bridge. Raises ProfileError if the profile has none."""
    if joint.profile.bridge is None:
        raise ProfileError(f"{joint.name}: {joint.profile.name} is no bridge")
    return joint.profile.bridge


def place_of(number: int, joint: JointSpec, pin: str, where: str) -> Place:
    """Return the location of one pin. Raises ValueError if `where` names none."""
    inverted, bare = where.startswith("!"), where.removeprefix("!")
    channel = _CHANNEL.fullmatch(bare)
    if not bare:
        raise ValueError(f"pin {pin} has no channel or line")
    purpose = f"joint {joint.name}, pin {pin}"
    at = int(channel.group(1)) if channel else None
    return Place(number, pin, purpose, at, "" if channel else bare, inverted)


def places_of(number: int, joint: JointSpec) -> list[Place]:
    """Return all pins of a bridge. Raises ValueError for one that is missing, unknown or cannot do
    what the bridge needs. A pin that only gives power may be left out, if it is wired
    permanently."""
    bridge = bridge_of(joint)
    unknown = set(joint.pins) - {*bridge.levels, FAULT, PUMP}
    if unknown:
        known = ", ".join((*bridge.levels, FAULT, PUMP))
        raise ValueError(f"{joint.profile.name} has no pin {min(unknown)} (there are {known})")
    for pin in bridge.levels:
        if pin not in joint.pins and not may_be_left_out(bridge, pin):
            raise ValueError(f"pin {pin} of {joint.profile.name} is not given")
    places = [place_of(number, joint, pin, where) for pin, where in joint.pins.items()]
    for place in places:
        soft = place.pin in bridge.levels and bridge.needs_pwm(place.pin) and place.channel is None
        if soft:
            raise ValueError(
                f"pin {place.pin} needs a PWM channel, {place.gpio} is a GPIO line: motors are not "
                "driven by PWM made in software, but by the kernel's pwm-gpio where the "
                "robot file allows it"
            )
        if place.pin in (FAULT, PUMP) and place.channel is not None:
            what = "an input" if place.pin == FAULT else "no PWM"
            raise ValueError(f"pin {place.pin} is {what}: it needs a GPIO line")
    return places


def may_be_left_out(bridge: Bridge, pin: str) -> bool:
    """Whether the pin only switches the bridge's power: then it may be wired permanently."""
    driven = [bridge.levels[pin][mode] for mode in ("brake", "forward", "reverse")]
    return all(level == (1.0, 0.0) for level in driven)


def lines_take_power(joint: JointSpec) -> bool:
    """Whether the joint's GPIO lines end motion by themselves at COAST: their levels then differ
    from forward and from backward. Those of PWM and DIR do not differ: they only give the
    direction."""
    bridge = bridge_of(joint)
    lines = [
        bridge.levels[place.pin]
        for place in places_of(0, joint)
        if place.channel is None and place.pin in bridge.levels
    ]
    return all(
        any((levels["coast"][0] >= 0.5) != (levels[direction][0] >= 0.5) for levels in lines)
        for direction in ("forward", "reverse")
    )


@dataclass(slots=True)
class OpenPins:
    """All open pins of a line. This object owns the descriptors."""

    pins: list[Pin] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    """Purpose of each pin."""
    fault_masks: list[int] = field(default_factory=list)
    """Masks of the fault inputs, by the joint's index."""
    low_inputs: int = 0
    """Mask of the inputs that are active when they are low."""
    outputs_fd: int = -1
    inputs_fd: int = -1
    channels: list[Channel] = field(default_factory=list)
    encoders: list[EncoderConfig | None] = field(default_factory=list)
    """Encoders, by the joint's index; None: no encoder."""
    doubt: str = ""
    """Why pulses may not reach the pins, in a sentence; "": no reason is known."""

    def close(self) -> list[str]:
        """Close the pins after the thread has brought them to rest. Return which pulses could not
        be ended, in words."""
        problems = []
        for name, channel in zip(self.names, self.channels, strict=False):  # lines come after them
            try:
                channel.close()
            except PortError as error:
                problems.append(f"{name}: {error}")
        for fd in (self.outputs_fd, self.inputs_fd):
            if fd >= 0:
                os.close(fd)
        for encoder in self.encoders:
            if encoder is not None and encoder.fd >= 0:
                os.close(encoder.fd)
        return problems


async def open_pins(spec: LineSpec) -> OpenPins:
    """Open all pins. Raises PortError or ProfileError; nothing stays open then. A motor may still
    turn if a program was killed, so every pin that can be brought to rest is, even if others are
    missing."""
    try:
        return await _open_all(spec)
    except PortError as error:
        more = [text for text in await rest_pins(spec) if text != str(error)]
        if not more:
            raise
        raise PortError(f"{error}; not brought to rest: {'; '.join(more)}") from error


async def _open_all(spec: LineSpec) -> OpenPins:
    opened = OpenPins(fault_masks=[0] * len(spec.joints))
    with contextlib.ExitStack() as undo:
        undo.callback(opened.close)
        places = _places(spec)
        inputs = [place for place in places if place.pin == FAULT]
        lines = [place for place in places if place.pin != FAULT and place.channel is None]
        _open_inputs(spec, opened, inputs)
        for joint in spec.joints:
            opened.encoders.append(_open_encoder(spec, joint))
        # a channel may still run: it is brought to rest before a line can give another direction
        await _open_channels(spec, opened, [place for place in places if place.channel is not None])
        _open_outputs(spec, opened, lines)
        undo.pop_all()
    return opened


def _places(spec: LineSpec) -> list[Place]:
    try:
        return [place for n, joint in enumerate(spec.joints) for place in places_of(n, joint)]
    except ValueError as error:
        raise ProfileError(f"{spec.name}: {error}") from error


def _levels(spec: LineSpec, place: Place) -> dict[str, tuple[float, float]]:
    return bridge_of(spec.joints[place.joint]).levels.get(place.pin, _LOW)


def _open_inputs(spec: LineSpec, opened: OpenPins, places: list[Place]) -> None:
    if not places:
        return
    wanted = [Wanted(line=place.gpio, purpose=place.purpose) for place in places]
    opened.inputs_fd = request_inputs(spec.pins.gpio_chip, wanted, f"motord {spec.name}")
    for bit, place in enumerate(places):
        opened.fault_masks[place.joint] |= 1 << bit
        opened.low_inputs |= place.inverted << bit


def _open_encoder(spec: LineSpec, joint: JointSpec) -> EncoderConfig | None:
    if joint.encoder is None:
        return None
    if isinstance(joint.encoder, BoardEncoder):
        return board_encoder(joint.encoder)
    if isinstance(joint.encoder, CounterEncoder):
        return open_counter(joint.encoder, joint.name)
    return open_edges(joint.encoder, joint.name, f"motord {spec.name}")


def _open_outputs(spec: LineSpec, opened: OpenPins, places: list[Place]) -> None:
    if not places:
        return
    wanted = [
        Wanted(
            line=place.gpio,
            purpose=place.purpose,
            high=(_levels(spec, place)["coast"][0] >= 0.5) != place.inverted,
        )
        for place in places
    ]
    opened.outputs_fd = request_outputs(spec.pins.gpio_chip, wanted, f"motord {spec.name}")
    for bit, place in enumerate(places):
        levels = _levels(spec, place)
        opened.names.append(place.purpose)
        opened.pins.append(
            Pin(joint=place.joint, fd=-1, bit=bit, inverted=place.inverted, period_ns=0,
                levels=levels, pumps=place.pin == PUMP)
        )  # fmt: skip


async def _open_channels(spec: LineSpec, opened: OpenPins, places: list[Place]) -> None:
    if not places:
        return
    chip = _find_chip(spec)
    if made_in_software(chip):
        _allow_software(spec, places)
    for place in places:
        channel = await _open_channel(spec, chip, place)
        opened.channels.append(channel)
        opened.names.append(place.purpose)
        opened.pins.append(
            Pin(joint=place.joint, fd=channel.duty_fd, bit=0, inverted=place.inverted,
                period_ns=period_ns(spec, place), levels=_levels(spec, place))
        )  # fmt: skip
    opened.doubt = not_muxed(device_of(chip), _channels(spec))


def _channels(spec: LineSpec) -> list[int]:
    return [place.channel for place in _places(spec) if place.channel is not None]


def _find_chip(spec: LineSpec) -> Path:
    """Return the PWM chip. Raises PortError with the step that gives the channels their pins."""
    try:
        return find_chip(spec.pins.pwm_chip)
    except ChipAbsent as error:
        first = next(place for place in _places(spec) if place.channel is not None)
        lines = [place.gpio for place in _places(spec)]
        step = pwm_step(spec.pins.pwm_chip, _channels(spec), lines)
        raise PortError(f"{first.purpose}: {error}. {step}") from error


def _allow_software(spec: LineSpec, places: list[Place]) -> None:
    """Raise PortError if the robot file does not allow it, or the frequency is too high."""
    pulses = f"{spec.name}: the pulses of {spec.pins.pwm_chip} are made in software"
    if not spec.pins.software_pwm:
        raise PortError(
            f"{pulses}, and late when the machine is busy: software_pwm = true in the line's "
            "section allows them for motors"
        )
    if min(period_ns(spec, place) for place in places) < SOFTWARE_PERIOD_MIN_NS:
        raise PortError(f"{pulses}: the line's pwm_hz must be at most 1000")


async def rest_pins(spec: LineSpec) -> list[str]:
    """Set every pin to no power, even if another one fails; then release the pins. Channels come
    first, all at once; lines follow even if the caller has given up on the channels. While the
    pulses of a motor continue, its direction pins stay as they are. Return what could not be done,
    in words. Raises ProfileError."""
    places = _places(spec)
    channels = [place for place in places if place.channel is not None]
    problems: list[str] = []
    driven = set(channels)
    try:
        if channels:
            chip = _find_chip(spec)
            rests = [_rest_channel(spec, chip, place, driven) for place in channels]
            for failed in filter(None, await asyncio.gather(*rests, return_exceptions=True)):
                if not isinstance(failed, PortError):
                    raise failed
                problems.append(str(failed))
    except PortError as error:
        problems.append(str(error))
    finally:
        problems += _rest_lines(spec, places, {place.joint for place in driven})
    return problems


async def _rest_channel(spec: LineSpec, chip: Path, place: Place, driven: set[Place]) -> None:
    channel = await _open_channel(spec, chip, place)
    with _saying(place):
        channel.close()
    driven.discard(place)


def _rest_lines(spec: LineSpec, places: list[Place], driven: set[int]) -> list[str]:
    """Set the lines to rest all at once; if one is busy or missing, the others. `driven`: joints
    whose pulses may continue. Return the problems."""
    lines = [
        place
        for place in places
        if place.channel is None
        and place.pin != FAULT
        and (
            place.joint not in driven
            or place.pin == PUMP
            or lines_take_power(spec.joints[place.joint])
        )
    ]
    try:
        _set_at_rest(spec, lines)
        return []
    except PortError as error:
        if len(lines) == 1:
            return [str(error)]
    problems: list[str] = []
    stuck: set[int] = set()
    alone, together = split_for_rest(spec, lines, driven)
    for group in [*([place] for place in alone), *together]:
        try:
            if group[0] in alone or group[0].joint not in stuck:
                _set_at_rest(spec, group)
        except PortError as error:
            stuck.add(group[0].joint)
            problems.append(str(error))
    return list(dict.fromkeys(problems))


def split_for_rest(
    spec: LineSpec, lines: list[Place], driven: set[int]
) -> tuple[list[Place], list[list[Place]]]:
    """Return lines that may rest one by one, then groups that may only rest together. A group
    belongs to a driven joint: two lines that brake it would pass through a direction, and a
    direction line would reverse it."""
    alone = [place for place in lines if place.joint not in driven or _takes_power(spec, place)]
    others = ([p for p in lines if p.joint == joint and p not in alone] for joint in sorted(driven))
    return alone, [group for group in others if group]


def _takes_power(spec: LineSpec, place: Place) -> bool:
    """Whether the line ends motion by itself: its level at COAST differs from both directions."""
    levels = {mode: base >= 0.5 for mode, (base, _) in _levels(spec, place).items()}
    return place.pin == PUMP or levels["coast"] not in (levels["forward"], levels["reverse"])


def _set_at_rest(spec: LineSpec, lines: list[Place]) -> None:
    """Set the lines to rest at once, and release them. Raises PortError."""
    opened = OpenPins(fault_masks=[0] * len(spec.joints))
    try:
        _open_outputs(spec, opened, lines)
    finally:
        opened.close()


def period_ns(spec: LineSpec, place: Place) -> int:
    return round(1e9 / (spec.pins.pwm_hz or bridge_of(spec.joints[place.joint]).pwm_hz))


async def _open_channel(spec: LineSpec, chip: Path, place: Place) -> Channel:
    base, _ = _levels(spec, place)["coast"]
    period = period_ns(spec, place)
    high_ns = round(base * period)
    rest_ns = period - high_ns if place.inverted else high_ns
    assert place.channel is not None  # a PWM pin
    with _saying(place):
        return await open_channel(chip, place.channel, period, rest_ns)


@contextlib.contextmanager
def _saying(place: Place) -> Iterator[None]:
    """Put the pin's purpose before the text of a PortError."""
    try:
        yield
    except PortError as error:
        raise PortError(f"{place.purpose}: {error}") from error
