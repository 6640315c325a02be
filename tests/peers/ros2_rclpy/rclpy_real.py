# SPDX-License-Identifier: Apache-2.0
"""A real rclpy for the tests: from a sourced ROS 2, or from the wheels that `make
build/ros-kilted/made` installs. The variable MOTORD_ROS names another such environment; if it
is empty, the tests use the stand-in.

Programs of such an environment run in its own Python. Its libraries find each other by
LD_LIBRARY_PATH, which a process reads once, at its start. This process has nodes, too. So
it loads all of them before rclpy loads them by name: glibc reuses a library that it has loaded."""

import ctypes
import importlib.util
import os
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
DISTRIBUTIONS = ("kilted", "jazzy")
_MISSING = re.compile(r"^(\S+): cannot open shared object file")


def made(distribution):
    """Return the environment made from wheels of `distribution`; None if there is no such."""
    folder = ROOT / f"build/ros-{distribution}"
    return folder if (folder / "made").is_file() else None


def site_of(folder):
    """Return the folder of Python packages of an environment."""
    return folder / f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"


def environ_of(folder):
    """Return the environment variables with which programs find the libraries of the wheels. The
    second one keeps the wheels from setting them and starting the program again."""
    libraries = [folder / "lib", *site_of(folder).glob("ros_*.libs")]
    return {
        "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries)),
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1",
    }


def _load(folder):
    files = {file.name: file for place in [folder / "lib", *site_of(folder).glob("ros_*.libs")]
             for file in place.glob("*.so*")}  # fmt: skip
    loaded = set()

    def load(name):
        while name not in loaded:
            try:
                ctypes.CDLL(str(files[name]))
            except OSError as error:
                missing = _MISSING.match(str(error))
                if missing is None or missing[1] not in files:
                    raise
                load(missing[1])
            else:
                loaded.add(name)

    for name in files:
        load(name)


def _found():
    if importlib.util.find_spec("rclpy") is not None:
        return None
    if (chosen := os.environ.get("MOTORD_ROS")) is not None:
        return Path(chosen).resolve() if chosen else None
    folders = (made(distribution) for distribution in DISTRIBUTIONS)
    return next((folder for folder in folders if folder and site_of(folder).is_dir()), None)


FOLDER = _found()
"""The environment of wheels that the tests use; None if ROS 2 is sourced or absent."""
REAL = FOLDER is not None or importlib.util.find_spec("rclpy") is not None
PYTHON = sys.executable if FOLDER is None else str(FOLDER / "bin/python")
ENVIRON = {} if FOLDER is None else environ_of(FOLDER)

if FOLDER is not None:
    _load(FOLDER)
    sys.path.append(str(site_of(FOLDER)))
