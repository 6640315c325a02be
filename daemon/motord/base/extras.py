# SPDX-License-Identifier: Apache-2.0
"""Command lines that install the packages of an optional part into this copy of motord."""

from __future__ import annotations

import importlib.util
import re
import shlex
import sys
import sysconfig


def how_to_install(extra: str) -> str:
    """Return a command line that installs what the extra of pyproject.toml needs, for the Python
    that runs now: a checkout's environment, a wheel's, or that of the Debian package, which has no
    pip."""
    from importlib import metadata  # imported here: it takes long, and is seldom needed

    rows = metadata.requires("motord") or []
    wanted = [
        row.partition(";")[0].strip()
        for row in rows
        if re.search(rf"""extra\s*==\s*['"]{re.escape(extra)}['"]""", row)
    ]
    packages = shlex.join(wanted or [extra])
    if importlib.util.find_spec("pip") is not None:
        return f"{shlex.quote(sys.executable)} -m pip install {packages}"
    target = shlex.quote(sysconfig.get_path("purelib"))
    return f"sudo python3 -m pip install --target {target} {packages}"


def numpy_missing() -> str:
    """Return what to do if numpy is missing; empty: it is installed."""
    if importlib.util.find_spec("numpy") is not None:
        return ""
    return f"numpy is not installed: {how_to_install('calibrate')}"
