# SPDX-License-Identifier: Apache-2.0
"""`motord drives`: list, show, check and create drive profiles."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from motord.cli.common import Exit, Failure, json_option, print_json
from motord.cli.complete import drive_names
from motord.cli.files.new_drive import new_drive
from motord.config.drives.load import find_profile, list_profiles, load_profile
from motord.config.drives.unknown import UNKNOWN
from motord_hal.base.errors import ProfileError
from motord_hal.drives.profile import SI_UNITS, DriveProfile, Register

_USAGE = {
    "list": "motord drives list",
    "show": "motord drives show NAME",
    "check": "motord drives check FILE",
    "new": "motord drives new FILE [--answers FILE]",
}
"""Usage by verb. No profile has such a name."""


@click.command
@click.argument("name", metavar="[VERB|NAME]", required=False, shell_complete=drive_names)
@click.argument("path", metavar="[NAME|FILE]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--answers",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="With new: read the answers from this TOML file instead of asking.",
)
@click.option(
    "--check",
    "file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Check a profile of your own and print every problem as file:line: key: problem.",
)
@json_option
def drives(
    name: str | None, path: Path | None, answers: Path | None, file: Path | None, as_json: bool
) -> None:
    """List the drive profiles, show one in full, check your own, or create a new one.

    A profile is a file that describes a drive: its registers and how to use them. A robot file
    refers to your own profile by its path, such as drive = "./mydrive.toml".

    \b
    Example: motord drives list
             motord drives show zlac8015d
             motord drives check mydrive.toml
             motord drives new mydrive.toml

    Without a verb, NAME is shown, and without NAME all are listed.
    """
    if name in _USAGE:
        verb, usage = name, _USAGE[name]
        wants_path = verb != "list"
        if wants_path != (path is not None) or file is not None or (answers and verb != "new"):
            raise click.UsageError(usage)
        if path is None:
            _list(as_json)
        elif verb == "new":
            new_drive(path, answers)
        elif verb == "check":
            _check(path, as_json)
        else:
            _show(str(path), as_json)
        return
    if path is not None or answers is not None:
        raise click.UsageError("; ".join(_USAGE.values()))
    if name is not None and file is not None:
        raise click.UsageError("give a name or --check FILE, not both")
    if file is not None:
        _check(file, as_json)
    elif name is not None:
        _show(name, as_json)
    else:
        _list(as_json)


def _check(file: Path, as_json: bool) -> None:
    problems: list[str] = []
    unknown: tuple[str, ...] = ()
    try:
        profile = load_profile(file)
        unknown = profile.unknown
    except ProfileError as error:
        problems = str(error).splitlines()
    if as_json:
        found = {"file": str(file), "problems": problems, "unknown": list(unknown)}
        print_json({"ok": not problems, **found})
    elif problems:
        click.echo("\n".join(problems))
    else:
        click.echo(f"{file}: ok: {profile.name}, {len(profile.registers)} registers")
        for fact in profile.unknown:
            click.echo(f"  unknown: {fact}: {UNKNOWN[fact]}")
    if problems:
        raise click.exceptions.Exit(Exit.USAGE)


def _list(as_json: bool) -> None:
    profiles = []
    for name in list_profiles():
        try:
            profiles.append(find_profile(name))
        except ProfileError as error:
            raise Failure(str(error)) from None
    if as_json:
        print_json({"drives": [_summary(profile) for profile in profiles]})
        return
    width = max(len(profile.name) for profile in profiles)
    for profile in profiles:
        channels = len(profile.channels)
        click.echo(f"{profile.name:{width}}  {profile.title}")
        click.echo(f"{'':{width}}  {channels} channel{'s' * (channels > 1)}, {_watchdog(profile)}")


def _summary(profile: DriveProfile) -> dict[str, Any]:
    return {
        "name": profile.name,
        "title": profile.title,
        "protocol": profile.protocol,
        "channels": len(profile.channels),
        "watchdog": asdict(profile.watchdog) if profile.watchdog else None,
        "watchdog_note": profile.watchdog_note,
        "watchdog_fixed_s": profile.watchdog_fixed_s or None,
    }


def _watchdog(profile: DriveProfile) -> str:
    dog = profile.watchdog
    if dog is None:
        fixed_s = profile.watchdog_fixed_s
        what = f"watchdog fixed at {fixed_s:g} s" if fixed_s else "no watchdog"
        what = "watchdog unknown" if "watchdog" in profile.unknown else what
        return f"{what} ({profile.watchdog_note})"
    return f"watchdog {dog.minimum_s:g} to {dog.maximum_s:g} s, {dog.action}"


def _show(name: str, as_json: bool) -> None:
    try:
        profile = find_profile(name)
    except ProfileError as error:
        raise Failure(str(error), Exit.USAGE) from None
    if as_json:
        print_json(asdict(profile) | {"path": str(profile.path)})
        return
    serial = f"{profile.baudrate} baud, parity {profile.parity}, {profile.stop_bits} stop bit(s)"
    rows = [
        ("title", profile.title),
        ("file", str(profile.path)),
        ("source", profile.source),
        ("serial", f"{profile.protocol}, {serial}, unit {profile.unit}"),
        ("counter", _counter(profile)),
        ("watchdog", _watchdog(profile)),
    ]
    for key, text in rows:
        click.echo(f"{key:9} {text}")
    for number, channel in profile.channels.items():
        click.echo(f"\nchannel {number}")
        for key, value in asdict(channel).items():
            if value not in (None, ()):
                click.echo(f"  {key:17} {_entry(value)}")
    click.echo("\nregisters")
    for register in profile.registers.values():
        click.echo(_register(register))
        click.echo(f"          {register.source}")
    click.echo("\nfaults")
    for fault in profile.faults:
        which = f"bit {fault.bit}" if fault.bit is not None else f"code {fault.code}"
        click.echo(f"  {which:8} {fault.severity:7} {fault.text}")


def _entry(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {part}" for key, part in value.items())
    if isinstance(value, tuple):
        return ", ".join(f"{name} = {raw}" for name, raw in value)
    return str(value)


def _counter(profile: DriveProfile) -> str:
    if not profile.counter_bits:
        return "none"
    return f"{profile.counts_per_turn} counts a motor turn, {profile.counter_bits} bits"


def _register(register: Register) -> str:
    si_unit = SI_UNITS[register.unit][0]
    unit = "" if register.unit in ("", si_unit) else f" {register.unit}"
    ends = [
        f"{word} {end:g}{unit}"
        for word, end in (("from", register.minimum), ("to", register.maximum))
        if end is not None
    ]
    text = f"  {register.address:#06x}  {register.name}: {register.type.value} {register.access}"
    if si_unit:
        zero = register.to_si(0)  # not 0 if the drive counts from another value
        text += f", 1 is {register.to_si(1) - zero:.4g} {si_unit}"
        text += f" above {zero:.4g}" if zero else ""
    return ", ".join([text, *ends])
