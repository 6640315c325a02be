# SPDX-License-Identifier: Apache-2.0
"""`motord params`: change limits of the running robot and registers of its drives, and save limits
in the robot file."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from motord.cli.common import dry_run_option, file_option, json_option, print_json, yes_option
from motord.cli.complete import parameter_names, settable_names
from motord.cli.running.talk import talking
from motord.client import Client, ClientError
from motord_hal.base import bounded

force_option = click.option(
    "--force",
    is_flag=True,
    help="Also set limits beyond those of the robot file.",
)


@click.group
def params() -> None:
    """Limits of the running robot, and registers of its drives: list, get, set, save, dump, load.

    Limits last until the daemon ends; save writes them into the robot file. Registers
    (drive.JOINT.REGISTER, as the profile names them, in SI) are set while the robot is disarmed,
    are read back, and last until the drive loses its power: nothing is stored in the drive.

    \b
    Example: motord params list
             motord params set limits.linear_m_s=0.3 limits.linear_m_s3=inf
             motord params get drive.left.bus_voltage
    """


@params.command("list")
@json_option
@talking
def params_list(client: Client, as_json: bool) -> None:
    """List the parameters with unit and range; r: read only.

    \b
    Example: motord params list
    """
    found = client.params_list()
    if as_json:
        print_json(found)
        return
    width = max(map(len, found))
    for name, about in found.items():
        value = about.get("access") or _number(about["value"])  # only `get` reads from drives
        span = f"{about['minimum']:g} to {_number(about['maximum'])}"
        click.echo(f"{name:{width}}  {value:>7} {about['unit']:6} {span}; {about['description']}")


@params.command("get")
@click.argument("names", nargs=-1, shell_complete=parameter_names)
@json_option
@talking
def params_get(client: Client, names: tuple[str, ...], as_json: bool) -> None:
    """Show values by name; without a name, all limits and gains.

    \b
    Example: motord params get limits.linear_m_s drive.left.bus_voltage
    """
    _show_values(client.params_get(*names), as_json=as_json)


@params.command("set")
@click.argument(
    "assignments", metavar="NAME=VALUE...", nargs=-1, required=True, shell_complete=settable_names
)
@force_option
@json_option
@talking
def params_set(client: Client, assignments: tuple[str, ...], force: bool, as_json: bool) -> None:
    """Change limits and gains, all or none, and registers; inf: no limit.

    A limit above the robot file's, or one by which a stop goes further, needs --force. No speed
    goes above what the wheels can do.

    \b
    Example: motord params set limits.linear_m_s=0.3 limits.linear_m_s3=inf
    """
    wanted = _assignments(client, assignments)
    _show_values(client.params_set(**wanted, **_forced(force)), as_json=as_json)


@params.command("save")
@file_option
@yes_option
@dry_run_option
@json_option
@talking
def params_save(
    client: Client, robot_file: Path | None, yes: bool, dry_run: bool, as_json: bool
) -> None:
    """Write the limits and gains in force into the robot file.

    Comments stay. The old file is kept beside it as ROBOT.toml.TIME.bak. What comes from --set
    options of the daemon counts as in force, too. Registers of drives are not saved: a robot file
    holds none.

    \b
    Example: motord params set limits.linear_m_s=0.3 && motord params save
    """
    from motord.cli.terminal import Terminal, failing
    from motord.commission.params_save import put_in_force
    from motord.commission.robot_file_edit import RobotFileEdit, write_asking

    with failing(), Terminal(yes=yes) as person:
        edit = RobotFileEdit(robot_file or _file_of(client))
        put, diff = put_in_force(edit, client.params_get()), edit.diff()
        backup = write_asking(person, edit, dry_run=dry_run)
    if as_json:
        shown = {name: None if value == math.inf else value for name, value in put.items()}
        answer = {"file": str(edit.path), "saved": shown, "backup": backup and str(backup)}
        print_json(answer | {"diff": diff})


def _file_of(client: Client) -> Path:
    file = client.call("robot").get("file")
    if file is None:
        raise ClientError("the daemon does not name its robot file: give it with --file ROBOT.toml")
    return Path(file)


def _assignments(client: Client, texts: Sequence[str]) -> dict[str, float | None]:
    return dict(_assignment(client, text) for text in texts)


@params.command("dump")
@talking
def params_dump(client: Client) -> None:
    """Print limits and gains, and what can be set in the drives, as TOML.

    \b
    Example: motord params dump > tuned.toml
    """
    found = client.params_list()
    names = [name for name, about in found.items() if about.get("access") != "r"]
    for name, value in client.params_get(*names).items():
        click.echo(f"{name} = {'inf' if value is None else repr(float(value))}")


@params.command("load")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@force_option
@json_option
@talking
def params_load(client: Client, file: Path, force: bool, as_json: bool) -> None:
    """Set the values of a file that `dump` has printed, limits first.

    \b
    Example: motord params load tuned.toml
    """
    try:
        wanted = dict(_leaves("", bounded.toml(bounded.read(file).decode())))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise click.UsageError(f"{file}: {error}") from error
    assignments = _assignments(client, [f"{name}={value}" for name, value in wanted.items()])
    of_drives = {name: one for name, one in assignments.items() if name.startswith("drive.")}
    ours = {name: one for name, one in assignments.items() if name not in of_drives}
    done = client.params_set(**ours, **_forced(force)) if ours else {}
    if of_drives:
        done |= client.params_set(**of_drives)
    _show_values(done, as_json=as_json)


def _forced(force: bool) -> dict[str, bool]:
    return {"force": True} if force else {}


def _leaves(prefix: str, table: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value


def _assignment(client: Client, text: str) -> tuple[str, float | None]:
    name, equals, value = text.partition("=")
    if not equals:
        raise click.UsageError(f"{text!r} is not NAME=VALUE, as in limits.linear_m_s=0.3")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if math.isnan(number):
        about = client.params_list().get(name)
        span = f" ({_span(about)})" if about else ""
        text = f"{name}: {value!r} is not a number, as 0.3 or inf (no limit){span}"
        raise click.UsageError(text)
    return name, None if number == math.inf else number


def _show_values(values: dict[str, float | None], *, as_json: bool) -> None:
    if as_json:
        print_json(values)
        return
    for name, value in values.items():
        click.echo(f"{name} = {_number(value)}")


def _number(value: float | None) -> str:
    return "inf" if value is None else f"{value:g}"


def _span(about: dict[str, Any]) -> str:
    return f"{about['minimum']:g} to {_number(about['maximum'])} {about['unit']}"
