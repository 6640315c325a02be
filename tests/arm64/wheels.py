# SPDX-License-Identifier: Apache-2.0
"""wheels.py FOLDER: downloads the packages that the project and its tests need, as wheels for
aarch64 and Python 3.11, and as source where there is no wheel (evdev)."""

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PYTHON = "3.11"
GLIBC_MINOR = (17, 24, 26, 27, 28, 31, 34, 35, 36)
"""Minor versions x of the platform tags manylinux_2_x (PEP 600); Debian 12 has glibc 2.36."""
SOURCE_ONLY = ("evdev",)
NOT_THERE = ("cyclonedds",)
"""Packages that are left out: they have no wheel for aarch64 (docs/ros2.md)."""


def main(folder: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["test"]]
    wanted += ["setuptools>=77", "wheel"]
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--dest", folder]
    platforms = [f"manylinux_2_{minor}_aarch64" for minor in GLIBC_MINOR]
    options = [
        part for one in (*platforms, "manylinux2014_aarch64") for part in ("--platform", one)
    ]
    options += [part for abi in ("cp311", "abi3", "none") for part in ("--abi", abi)]
    options += ["--python-version", PYTHON, "--implementation", "cp", "--only-binary=:all:"]
    ready = [one for one in wanted if not one.startswith((*SOURCE_ONLY, *NOT_THERE))]
    subprocess.run([*pip, *options, *ready], check=True, timeout=600)
    sources = [one for one in wanted if one.startswith(SOURCE_ONLY)]
    more = ["--no-deps", "--no-binary=:all:", "--no-build-isolation"]
    subprocess.run([*pip, *more, *sources], check=True, timeout=300)


if __name__ == "__main__":
    main(*sys.argv[1:])
