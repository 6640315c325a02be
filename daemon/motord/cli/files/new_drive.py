# SPDX-License-Identifier: Apache-2.0
"""`motord drives new`: begin a drive profile from answers."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

import click

from motord.cli.common import Exit, Failure
from motord.config.drives.load import load_profile
from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError
from motord_hal.base.paths import config_dir

QUESTIONS: tuple[tuple[str, str, str | int], ...] = (
    ("title", "Maker and model", "My drive"),
    ("source", "Where its registers are written down (manual, version, page)", "manual"),
    ("baudrate", "Baud rate", 115200),
    ("parity", "Parity (none, even, odd)", "none"),
    ("write_function", "Function that writes (6 or 16)", 6),
    ("speed_address", "Address of the speed set-point, signed, 16 bits, 1 rpm", 0x0200),
    ("speed_maximum_rpm", "Fastest speed of the motor in rpm", 3000),
    ("velocity_address", "Address of the measured speed, signed, 16 bits, 1 rpm", 0x0204),
    ("enable_address", "Address of the register that enables with 1 and disables with 0", 0x0201),
    ("watchdog_address", "Address of its communication time-out in ms (-1: it has none)", -1),
)
_TEMPLATE = """\
#:schema {schema}
# {title}: begun by `motord drives new`. Every address has a source: put its page there.
schema = 1
name = "{name}"
title = "{title}"
protocol = "modbus-rtu"
source = "{source}"
{note}
[serial]
baudrate = {baudrate}
parity = "{parity}"
stop_bits = 1
unit = 1
turnaround_s = 0.02         # longest time until it answers: measure it, or leave it generous
max_registers = 16
write_function = {write_function}

[register.target_velocity]
address = {speed_address:#06x}
type = "i16"
unit = "rpm"
minimum = -{speed_maximum_rpm}
maximum = {speed_maximum_rpm}
access = "rw"
source = "{source}"

[register.velocity]
address = {velocity_address:#06x}
type = "i16"
unit = "rpm"
access = "r"
source = "{source}"

[register.enable]
address = {enable_address:#06x}
type = "u16"
access = "rw"
source = "{source}"
{watchdog}
[channel.1]
velocity_setpoint = "target_velocity"
velocity = "velocity"

[steps]
configure = [
    {{ write = "target_velocity", value = 0 }},
    {{ write = "enable", value = 0 }},
]
arm = [{{ write = "enable", value = 1 }}]
disarm = [
    {{ write = "target_velocity", value = 0 }},
    {{ write = "enable", value = 0 }},
]
quick_stop = [
    {{ write = "target_velocity", value = 0 }},
    {{ write = "enable", value = 0 }},
]
clear_fault = []
"""
_WATCHDOG = """
[register.communication_timeout]
address = {watchdog_address:#06x}
type = "u16"
unit = "ms"
access = "rw"
source = "{source}"

[watchdog]
register = "communication_timeout"
minimum_s = 0.02
maximum_s = 10
action = "stops the motor"
"""
_NOTE = 'watchdog_note = "it has none: give the robot an e-stop that cuts its power"\n'


def new_drive(path: Path, answers_file: Path | None) -> None:
    """Write a new profile and check it. Never overwrites a file."""
    if path.suffix != ".toml":
        path = path.with_name(f"{path.name}.toml")
    if path.exists():
        raise Failure(f"{path} is there already: name another file", Exit.USAGE)
    text = _filled(path.stem, _ask() if answers_file is None else _read(answers_file))
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
        load_profile(path)
    except OSError as error:
        raise Failure(f"{path}: {error.strerror}", Exit.USAGE) from error
    except ProfileError as error:
        path.unlink()
        raise Failure(f"these answers give no valid profile:\n{error}", Exit.USAGE) from None
    click.echo(f"{path}: written. Next: put in what is missing (faults, current, counter), then")
    click.echo(f"  motord drives --check {path}")


def _ask() -> dict[str, str | int]:
    return {key: click.prompt(text, default=default) for key, text, default in QUESTIONS}


def _read(file: Path) -> dict[str, str | int]:
    try:
        given: Mapping[str, object] = bounded.toml(bounded.read(file).decode())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Failure(f"{file}: {error}", Exit.USAGE) from error
    answers = {key: default for key, _, default in QUESTIONS}
    for key, value in given.items():
        if key not in answers:
            raise Failure(f"{file}: {key}: known are {', '.join(answers)}", Exit.USAGE)
        kind = type(answers[key])
        if isinstance(value, bool) or not isinstance(value, kind):
            raise Failure(f"{file}: {key}: {value!r} must be {kind.__name__}", Exit.USAGE)
        answers[key] = value
    return answers


def _filled(name: str, answers: dict[str, str | int]) -> str:
    for key, value in answers.items():
        if isinstance(value, str) and not re.fullmatch(r'[^"\\\x00-\x1f\x7f]+', value):
            raise Failure(f"{key}: no quotes, backslashes or control characters", Exit.USAGE)
    has_one = int(answers["watchdog_address"]) >= 0
    watchdog = _WATCHDOG.format(**answers) if has_one else ""
    note = "" if has_one else _NOTE
    schema = (config_dir() / "schema" / "drive.schema.json").as_uri()
    return _TEMPLATE.format(schema=schema, name=name, note=note, watchdog=watchdog, **answers)
