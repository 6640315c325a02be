# SPDX-License-Identifier: Apache-2.0
"""`motord scan`: find the drives on a serial port or a CAN bus, and their addresses."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from motord.cli.common import Exit, Failure, json_option, print_json, usual_option

if TYPE_CHECKING:
    from motord.tools.scan import Found, Trial


def _units(_context: click.Context, _option: click.Parameter, text: str) -> range:
    """Parse `7` or `1-32`. The range is that of servos, the largest; Modbus has 1 to 247."""
    from motord_hal.servo.packets import UNIT_MAX

    first, _, last = text.partition("-")
    try:
        units = range(int(first), int(last or first) + 1)
    except ValueError:
        raise click.BadParameter(f'"{text}" is not a range of units such as 1-32') from None
    if not units or units[0] < 0 or units[-1] > UNIT_MAX:
        raise click.BadParameter(f"units are 0 to {UNIT_MAX}")
    return units


@click.command
@click.argument("port")
@click.option(
    "--units",
    "--unit",
    callback=_units,
    default="1-16",
    help="Units to look for on a serial line, such as 7 or 1-32. Default: 1-16.",
)
@click.option(
    "--baudrate", type=click.IntRange(300, 4_500_000),
    help="Try only this one. Bit rate of a CAN adapter that is not the kernel's.",
)  # fmt: skip
@click.option("--parity", type=click.Choice(["none", "even", "odd"]), help="Try only this one.")
@usual_option("--within-s", click.FloatRange(0.1, 3600), 60.0, "Stop the scan after this time.")
@click.option(
    "--directions",
    is_flag=True,
    help="Find how the transceiver changes direction. Needs exactly one unit.",
)
@click.option("--gpio-chip", default="", help="For --directions: GPIO chip of the DE line.")
@click.option("--gpio-line", default="", help="For --directions: name or number of the DE line.")
@json_option
def scan(
    port: str,
    units: range,
    baudrate: int | None,
    parity: str | None,
    within_s: float,
    directions: bool,
    gpio_chip: str,
    gpio_line: str,
    as_json: bool,
) -> None:
    """Find the drives on the line at PORT: baud rate, parity, units and matching profiles.

    The scan only reads. PORT is a device file or usb:SERIAL, which no other program may have open,
    or a CAN interface: can0, or KIND:CHANNEL of another adapter. On CAN it listens first. If
    nothing comes, it tries one protocol after the other; otherwise it sends requests only of the
    protocols that it has recognised. The exit status is 0 if a drive answered, 1 if none did, and 3
    if the port cannot be opened.

    \b
    Example: motord scan /dev/ttyUSB0
             motord scan can0
             motord scan /dev/ttyUSB0 --units 1-247 --baudrate 115200
             motord scan /dev/ttyAMA0 --directions --unit 1 --baudrate 115200
    """
    from motord.commission.setup.hardware import place_of
    from motord.tools.scan import USUAL
    from motord_hal.base.errors import PortError

    if place_of(port).kind == "can":
        _scan_can(port, baudrate, as_json=as_json)
        return
    settings = list(dict.fromkeys((baudrate or rate, parity or mark) for rate, mark in USUAL))
    try:
        if directions:
            _try_directions(port, settings[0], units, (gpio_chip, gpio_line), as_json)
        else:
            _scan(port, settings, units, within_s, as_json)
    except PortError as error:
        raise Failure(str(error), Exit.FAULT) from error


def _say(text: str) -> None:
    click.echo(text, err=True)


def _scan(
    port: str, settings: list[tuple[int, str]], units: range, within_s: float, as_json: bool
) -> None:
    from motord.tools.scan import bound_s, scan

    most_s = min(bound_s(settings, units), within_s)
    _say(f"{port}: {len(settings)} settings, {len(units)} units, at most {most_s:.0f} s; read only")
    found = list(scan(port, settings, units, within_s, _say))
    _report(
        port, found, as_json,
        "no unit answers: A and B swapped? power, ground, unit? docs/rs485.md goes on from here",
    )  # fmt: skip


def _scan_can(port: str, baudrate: int | None, *, as_json: bool) -> None:
    from motord.commission.setup.hardware import (
        FD_BITRATE,
        USUAL_BITRATE,
        can_address,
        carries_fd,
        interface_bit_rate,
    )
    from motord.tools.scan_can import scan_can
    from motord_hal.base.errors import PortError

    address = can_address(port)
    bitrate = baudrate or interface_bit_rate(address) or USUAL_BITRATE
    try:
        found = scan_can(address, bitrate, FD_BITRATE if carries_fd(address) else None, _say)
    except PortError as error:
        raise Failure(str(error), Exit.FAULT) from error
    _report(
        port, found, as_json,
        "no node answers: bit rate, termination, power? docs/can.md goes on from here",
    )  # fmt: skip


def _report(port: str, found: list[Found], as_json: bool, advice: str) -> None:
    """Print what was found. `advice`: what to do if nothing was found."""
    if as_json:
        print_json({"port": port, "found": [asdict(one) for one in found]})
    else:
        for one in found:
            _print(port, one)
    if not found:
        _say(advice)
        raise click.exceptions.Exit(Exit.FAILED)


def _print_node(port: str, found: Found) -> None:
    from motord.commission.setup.hardware import can_address

    interface, _, channel = can_address(port).partition(":")
    drive = found.matches[0].profile if found.matches else "..."
    line = f'kind = "can", interface = "{interface}", channel = "{channel}"'
    rows = [
        f"node {found.unit}: {found.answer}",
        f"    profiles: {', '.join(match.profile for match in found.matches) or 'none fits'}",
        "    for the robot file:",
        f"      [line.can]  {line}, bitrate = {found.baudrate}",
        f'      [joint.NAME]  line = "can", drive = "{drive}", unit = {found.unit}',
    ]
    click.echo("\n".join(rows))


def _print(port: str, found: Found) -> None:
    if found.kind == "can":
        _print_node(port, found)
        return
    rows = [f"unit {found.unit} at {found.baudrate} baud, parity {found.parity}: {found.answer}"]
    rows += [
        f"    {match.profile}: {match.fitting} of {match.asked} registers fit"
        for match in found.matches[:3]
    ]
    if not found.matches:
        rows.append("    no drive profile fits: `motord drives new` starts one")
    drive = found.matches[0].profile if found.matches else "..."
    line = f'kind = "{found.kind}", port = "{port}", baudrate = {found.baudrate}'
    rows += [
        "    for the robot file:",
        f'      [line.rs485]  {line}, parity = "{found.parity}"',
        f'      [joint.NAME]  line = "rs485", drive = "{drive}", unit = {found.unit}',
    ]
    click.echo("\n".join(rows))


def _try_directions(
    port: str, setting: tuple[int, str], units: range, gpio: tuple[str, str], as_json: bool
) -> None:
    from motord.tools.scan import ASKED
    from motord.tools.scan import directions as tried
    from motord_hal.fieldbus.ports import DirectionKind, DirectionSpec

    if len(units) != 1:
        raise click.UsageError("--directions needs one unit: give it with --unit")
    kernel, line = DirectionKind.KERNEL, DirectionKind.GPIO
    low = "direction_active_high = false"
    directions = [
        ("auto", DirectionSpec(), ('direction = "auto"',)),
        ("kernel", DirectionSpec(kind=kernel), ('direction = "kernel"',)),
        ("kernel, active low", DirectionSpec(kind=kernel, active_high=False),
         ('direction = "kernel"', low)),
    ]  # fmt: skip
    if all(gpio):
        where = (f'direction_gpio_chip = "{gpio[0]}"', f'direction_gpio_line = "{gpio[1]}"')
        spec = DirectionSpec(kind=line, gpio_chip=gpio[0], gpio_line=gpio[1])
        directions.append(("gpio", spec, ('direction = "gpio"', *where)))
    trials: list[Trial] = []
    for trial in tried(port, *setting, units[0], directions):
        trials.append(trial)
        answer = trial.problem or (
            f"{trial.answers} of {ASKED} answers, {trial.echoes} echoes, "
            f"{trial.turnaround_ms:.1f} ms"
        )
        _say(f"{trial.name}: {answer}")
    best = max(trials, key=lambda trial: trial.answers)
    if as_json:
        values: list[dict[str, Any]] = [asdict(trial) for trial in trials]
        print_json({"port": port, "unit": units[0], "trials": values})
    elif best.answers:
        echo = "yes" if best.echoes else "no"
        click.echo("\n".join([*best.lines, f'echo = "{echo}"']))
    if not best.answers:
        raise Failure(f"unit {units[0]} does not answer in any of the modes of the transceiver")
