# SPDX-License-Identifier: Apache-2.0
"""`motord robots`: list and print the example robot files of motord."""

from __future__ import annotations

import click

from motord.cli.common import Exit, Failure, json_option, print_json
from motord.cli.complete import example_names
from motord_hal.base.nearest import did_you_mean
from motord_hal.base.paths import config_dir


@click.command
@click.argument("name", required=False, shell_complete=example_names)
@json_option
def robots(name: str | None, as_json: bool) -> None:
    """List the example robot files of motord, or print one as a start for your own.

    The printed file names the JSON Schema by its full path, so your editor completes the keys
    wherever you save the file.

    \b
    Example: motord robots
             motord robots demo > my-robot.toml
    """
    found = {path.stem: path for path in sorted((config_dir() / "robots").glob("*.toml"))}
    if name is None:
        titles = {stem: _title(path.read_text(encoding="utf-8")) for stem, path in found.items()}
        if as_json:
            print_json({"robots": [{"name": stem, "title": titles[stem]} for stem in titles]})
            return
        width = max(map(len, titles))
        for stem, title in titles.items():
            click.echo(f"{stem:{width}}  {title}")
        return
    if name not in found:
        known = ", ".join(found)
        message = f"there is no robot file {name!r}{did_you_mean(name, found)}; there are: {known}"
        raise Failure(message, Exit.USAGE)
    text = found[name].read_text(encoding="utf-8")
    if as_json:
        print_json({"name": name, "path": str(found[name]), "text": text})
    else:
        schema = config_dir() / "schema" / "robot.schema.json"
        click.echo(f"#:schema {schema.as_uri()}\n{text}", nl=False)


def _title(text: str) -> str:
    """Return the first sentence of the comment at the top of the file."""
    rows = []
    for row in text.splitlines():
        if not row.startswith("#"):
            break
        rows.append(row.removeprefix("#").strip())
    return " ".join(rows).partition(". ")[0].rstrip(".")
