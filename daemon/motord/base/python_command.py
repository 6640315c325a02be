# SPDX-License-Identifier: Apache-2.0
"""Command lines of the Python processes that motord starts. No other place builds one. `python -m`
alone looks for modules in the current folder first: `sudo motord run` would execute a `types.py` of
the folder in which it is typed as root."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module with the packages of this process, and never with those
    of the current folder. Without -I the child looks in the folders of PYTHONPATH, as this
    process does."""
    return [sys.executable, "-I" if sys.flags.isolated else "-P", "-m", module, *arguments]


def script_command(script: Path, *arguments: str) -> list[str]:
    """Return the command that runs a script which needs the standard library alone."""
    return [sys.executable, "-I", os.fspath(script), *arguments]
