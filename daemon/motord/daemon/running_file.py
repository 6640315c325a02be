# SPDX-License-Identifier: Apache-2.0
"""The robot file as it was when the daemon started, kept beside its socket. After a crash, motord
stop-all stops the drives that the daemon drove, however the file was changed since."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from motord.client import socket_folders, trusted_owners
from motord.config import Robot
from motord_hal.base import bounded

KEPT_BYTES_MAX = 8 * bounded.TOML_BYTES_MAX
_SUFFIX = ".running"
MODE = 0o600
"""The file may contain passwords of buses."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunningFile:
    """The robot file and options that a daemon uses, or has used."""

    file: str
    """Absolute path of the robot file."""
    text: str
    overrides: tuple[str, ...]
    """The --set options."""
    robot: str = ""
    """Name of the robot; empty: an older version kept the file."""
    pid: int = 0
    """The daemon's process."""


@contextlib.contextmanager
def kept(robot: Robot, folder: Path) -> Iterator[None]:
    """Keep the robot file until the daemon ends in good order. If that fails, log it and go on
    without."""
    ours = RunningFile(
        str(robot.path.absolute()), robot.text, robot.overrides, robot.robot.name, os.getpid()
    )
    place = folder / _name(robot.path)
    try:
        _write(place, json.dumps(asdict(ours)))
    except OSError as error:
        _log.warning("%s: cannot be kept for motord stop-all: %s", place, error.strerror)
    yield
    place.unlink(missing_ok=True)


def find(robot_file: Path, folders: Sequence[Path] | None = None) -> RunningFile | None:
    """Return the robot file that the last daemon on this file used, if that daemon did not end in
    good order. None: there is no such file, or it does not belong to a trusted user."""
    for folder in socket_folders() if folders is None else folders:
        if (found := _read(folder / _name(robot_file))) is not None:
            return found
    return None


def of_daemon(pid: int, robot: str, folder: Path) -> RunningFile | None:
    """Return the robot file that the daemon of this process and robot uses. `folder`: that of its
    local socket. None as in `find`."""
    found = map(_read, sorted(folder.glob(f"*{_SUFFIX}")))
    return next((ran for ran in found if ran and (ran.pid, ran.robot) == (pid, robot)), None)


def _read(place: Path) -> RunningFile | None:
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        if place.stat().st_uid in trusted_owners(place.parent):
            found = json.loads(bounded.read(place, KEPT_BYTES_MAX))
            return RunningFile(
                str(found["file"]),
                str(found["text"]),
                tuple(map(str, found["overrides"])),
                str(found.get("robot", "")),
                int(found.get("pid", 0)),
            )
    return None


def forget(robot_file: Path) -> None:
    """Remove the kept file, after the drives have been stopped."""
    for folder in socket_folders():
        with contextlib.suppress(OSError):
            (folder / _name(robot_file)).unlink()


def _name(robot_file: Path) -> str:
    """Return the name of the kept file. It is made from the robot file's path, not from the name of
    the robot, which is in the file."""
    path = os.fsencode(robot_file.absolute())
    return f"{robot_file.stem}.{hashlib.sha256(path).hexdigest()[:16]}{_SUFFIX}"


def _write(place: Path, text: str) -> None:
    """Write the file as a whole, or not at all."""
    new = place.with_suffix(".new")
    new.unlink(missing_ok=True)
    with open(
        os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, MODE), "w", encoding="utf-8"
    ) as at:
        at.write(text)
    new.replace(place)
