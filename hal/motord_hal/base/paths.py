# SPDX-License-Identifier: Apache-2.0
"""Where the files are that travel with the program."""

from __future__ import annotations

from pathlib import Path


def config_dir() -> Path:
    """The shipped config/ folder: packaged as motord_hal/_config in a wheel, else the checkout's.

    Raises FileNotFoundError where there is neither.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "_config", package.parent.parent / "config"):
        if (folder / "drives").is_dir():
            return folder
    raise FileNotFoundError(f"no config folder in {package} or beside it: is motord installed?")
