# SPDX-License-Identifier: Apache-2.0
"""Location of the files that are shipped with the program."""

from __future__ import annotations

from pathlib import Path


def config_dir() -> Path:
    """Return the shipped config/ folder: motord_hal/_config in a wheel, else the checkout's.

    Raises FileNotFoundError if there is neither."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "_config", package.parent.parent / "config"):
        if (folder / "drives").is_dir():
            return folder
    raise FileNotFoundError(f"no config folder in {package} or beside it: is motord installed?")
