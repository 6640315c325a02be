# SPDX-License-Identifier: Apache-2.0
"""`motord completion`: the script with which a shell completes commands and names after TAB."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_SHELLS = ("bash", "zsh", "fish")
_VARIABLE = "_MOTORD_COMPLETE"
"""Variable by which click recognizes a completion for the program motord."""


@click.command
@click.argument("shell", type=click.Choice(_SHELLS))
def completion(shell: str) -> None:
    """Print what makes TAB complete commands, options, robots, drives, joints and parameters.

    The Debian package installs it.

    \b
    Example: motord completion bash >> ~/.bashrc
             motord completion zsh > ~/.zfunc/_motord
             motord completion fish > ~/.config/fish/completions/motord.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root().command
    click.echo(kind(root, {}, "motord", _VARIABLE).source())
