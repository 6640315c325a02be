# SPDX-License-Identifier: Apache-2.0
"""Write man pages from the help: `python -m motord.cli.man FOLDER`, when the Debian package is
built.

Macros: man(7). The text comes from click's own objects, so a page and --help cannot differ."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import click

from motord.cli import COMMANDS, cli

_SECTION = 1
_STATUS = """0 success, 1 failure, 2 wrong usage or a wrong robot file,
3 a latched fault or missing hardware, 130 Ctrl\\-C."""


def pages() -> Iterator[tuple[str, str]]:
    """Return file name and text of each page: motord.1, motord-run.1, ..."""
    root = click.Context(cli, info_name="motord", **cli.context_settings)
    commands = {name: cli.get_command(root, name) for name in COMMANDS}
    shown = "".join(
        f".TP\n.BR motord\\-{_text(name)} ({_SECTION})\n{_text(about)}\n"
        for name, (_, about) in COMMANDS.items()
    )
    yield f"motord.{_SECTION}", _page(cli, root, "Drive the motors of a robot", shown)
    for name, command in commands.items():
        assert command is not None
        context = click.Context(command, root, info_name=name)
        yield f"motord-{name}.{_SECTION}", _page(command, context, COMMANDS[name][1].rstrip("."))


def _page(command: click.Command, context: click.Context, about: str, commands: str = "") -> str:
    name = context.command_path.replace(" ", "-")
    version = metadata.version("motord")
    page = f'.TH {_text(name.upper())} {_SECTION} "" "motord {version}" "motord"\n'
    page += f".SH NAME\n{_text(name)} \\- {_text(about)}\n"
    page += f".SH SYNOPSIS\n.B {_text(context.command_path)}\n{_usage(command, context)}\n"
    page += f".SH DESCRIPTION\n{_description(command.help or about)}"
    page += _options(command, context)
    if commands:
        page += f".SH COMMANDS\n{commands}"
    if isinstance(command, click.Group) and not commands:
        page += _subcommands(command, context)
    return page + f".SH EXIT STATUS\n{_STATUS}\n"


def _usage(command: click.Command, context: click.Context) -> str:
    return _text(" ".join(command.collect_usage_pieces(context)))


def _description(text: str) -> str:
    """Paragraphs; those after a \\b line, as it is in click, keep their lines."""
    rows = []
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        lines = [line.rstrip() for line in paragraph.splitlines()]
        if lines[0].strip() == "\b":
            rows.append(".PP\n.nf\n" + "\n".join(_text(line) for line in lines[1:]) + "\n.fi\n")
        else:
            rows.append(".PP\n" + _text(" ".join(line.strip() for line in lines)) + "\n")
    return "".join(rows).removeprefix(".PP\n")


def _options(command: click.Command, context: click.Context) -> str:
    records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
    return ".SH OPTIONS\n" + "".join(
        f".TP\n.B {_text(record[0])}\n{_text(record[1]) or 'No description.'}\n"
        for record in records
        if record is not None
    )


def _subcommands(group: click.Group, context: click.Context) -> str:
    rows = [".SH COMMANDS\n"]
    for name, command in group.commands.items():
        inside = click.Context(command, context, info_name=name)
        rows.append(f".SS {_text(name)} {_usage(command, inside)}\n")
        rows.append(_description(command.help or ""))
    return "".join(rows)


def _text(text: str) -> str:
    """Escape what roff would interpret."""
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace("'", "\\(aq")
    return re.sub(r"^\.", r"\\&.", escaped)


def main() -> None:
    """Write all pages into the folder."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
