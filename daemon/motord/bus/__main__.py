# SPDX-License-Identifier: Apache-2.0
"""Entry point of `motord-bus` and `python -m motord.bus`: motord/bus/process.py."""

from __future__ import annotations

import sys

from motord.base import validation
from motord.bus.confine import confine

CHECKED = "--checked-fd"


def main() -> None:
    """Run the second process, and exit."""
    confine()
    if CHECKED in sys.argv:
        validation.handed_over()
    else:
        validation.elsewhere()
    from motord.bus.process import main as run

    run(prog_name="motord-bus")


if __name__ == "__main__":
    main()
