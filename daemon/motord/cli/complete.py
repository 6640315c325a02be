# SPDX-License-Identifier: Apache-2.0
"""Completions of the shell after TAB: names of running robots, of their joints, lines and
parameters, of drive profiles and example robots. A daemon that does not answer soon gives no
names."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import click
from click.shell_completion import CompletionItem

from motord.client import Client, ClientError, find_socket, find_sockets
from motord_hal.base.paths import config_dir

ANSWER_WITHIN_S = 1.0
Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def _completing(names: Callable[[click.Context], Iterable[tuple[str, str]]]) -> Complete:
    """Return a completion: those of the names, with their help texts, that begin as typed."""

    def complete(ctx: click.Context, _: click.Parameter, typed: str) -> list[CompletionItem]:
        try:
            found = list(names(ctx))
        except (ClientError, OSError):  # no daemon, or no such folder
            return []
        return [CompletionItem(name, help=text) for name, text in found if name.startswith(typed)]

    return complete


def _ask(ctx: click.Context, method: str) -> Any:
    """Call a method of the daemon that the options name so far."""
    path = ctx.params.get("path") or find_socket(ctx.params.get("robot"))
    with Client(path, timeout_s=ANSWER_WITHIN_S) as client:
        return client.call(method)


def _parameters(ctx: click.Context) -> Iterable[tuple[str, str]]:
    for name, about in _ask(ctx, "params.list").items():
        yield name, f"{about['description']}, {about['unit']}"


def _settable(ctx: click.Context) -> Iterable[tuple[str, str]]:
    for name, about in _ask(ctx, "params.list").items():
        if about.get("access") != "r":
            yield f"{name}=", f"{about['description']}, {about['unit']}"


def _lines(ctx: click.Context) -> Iterable[tuple[str, str]]:
    for name, line in _ask(ctx, "status")["lines"].items():
        yield name, line["port"]


def _shipped(folder: str) -> Callable[[click.Context], Iterable[tuple[str, str]]]:
    return lambda _: [(path.stem, "") for path in sorted((config_dir() / folder).glob("*.toml"))]


robot_names = _completing(lambda _: [(path.stem, str(path)) for path in find_sockets(barred=True)])
joint_names = _completing(lambda ctx: [(name, "") for name in _ask(ctx, "robot")["joints"]])
line_names = _completing(_lines)
parameter_names = _completing(_parameters)
settable_names = _completing(_settable)
drive_names = _completing(_shipped("drives"))
example_names = _completing(_shipped("robots"))
