# SPDX-License-Identifier: Apache-2.0
"""`motord`, and `python -m motord`."""

from __future__ import annotations

import sys

from motord.base import validation
from motord.cli import cli


def main() -> None:
    """Run the command line; exits the process."""
    if sys.argv[1:2] == ["run"]:
        validation.elsewhere()
    cli(prog_name="motord")


if __name__ == "__main__":
    main()
