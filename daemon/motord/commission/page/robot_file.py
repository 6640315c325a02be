# SPDX-License-Identifier: Apache-2.0
"""The robot file in the dashboard's editor. For each request motord-bus starts `python -m
motord.commission.page.robot_file`; the request is on standard input, the answer on standard output,
both in JSON.

A text from a page may name files of this machine, and a problem may quote what is in them. So a
drive's profile is read only from the folder of the robot file, or if the file on disk names it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from motord.commission.robot_file_edit import (
    ConfigError,
    EditError,
    FileChanged,
    RobotFileText,
)
from motord.config import Problem
from motord.config.drives.load import is_file_name
from motord.config.reading import Places, parse, read_text

CHANGED = "the file on the robot is not the one that this page has loaded: another program wrote it"
ELSEWHERE = (
    "this page reads drive profiles from the robot file's folder alone (NAME.toml): put it there, "
    "or name it with an editor on the robot"
)


def carry_out(request: Mapping[str, Any]) -> dict[str, Any]:
    """Carry out a request and return the answer. In the request, `do` is "read", "check", "diff" or
    "save", `file` the path, `text` the new text, and `sha256` that of the file from which the text
    was made.

    The answer has `file`, the `sha256` of the file on disk, and `problems` and `warnings` like
    `motord check`; after "read" the `text`; after "diff" and "save" the `diff`; `backup` if the
    file was written. `failed`, `changed` and `unwritable` are reasons, in words, why it was not.
    """
    what = request["do"]
    try:
        edit = RobotFileText(Path(request["file"]), request.get("text"))
    except EditError as error:
        return {"failed": str(error)}
    answer: dict[str, Any] = {"file": str(edit.path), "sha256": edit.sha256}
    if what == "read":
        answer["text"] = edit.text
    if what in ("diff", "save"):
        if edit.sha256 != request["sha256"]:
            return answer | {"changed": CHANGED}
        answer["diff"] = edit.diff()
    answer |= _checked(edit)
    if what == "save" and edit.changed and not answer["problems"]:
        answer |= _saved(edit)
    return answer


def _checked(edit: RobotFileText) -> dict[str, Any]:
    problems: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()
    try:
        if elsewhere := tuple(_profiles_elsewhere(edit)):
            raise ConfigError(elsewhere)
        warnings = edit.checked().warnings
    except ConfigError as error:
        problems = error.problems
    return {
        "problems": [asdict(problem) for problem in problems],
        "warnings": [asdict(warning) for warning in warnings],
    }


def _profiles_elsewhere(edit: RobotFileText) -> Iterator[Problem]:
    """Return drives whose profiles a page must not have read. Raises ConfigError for bad TOML."""
    known: set[str] = set()
    if edit.changed:
        try:
            known = set(_drives(parse(edit.path, read_text(edit.path))).values())
        except ConfigError:
            known = set()  # it names no drives
    folder = edit.path.parent
    for joint, drive in _drives(parse(edit.path, edit.text)).items():
        if not (is_file_name(drive) and edit.changed) or drive in known:
            continue
        if not _in_folder(folder, drive):
            path = ("joint", joint, "drive")
            yield Places(str(edit.path), edit.text).problem(path, ELSEWHERE)


def _in_folder(folder: Path, drive: str) -> bool:
    try:
        file = (folder / drive).resolve()
    except (OSError, RuntimeError, ValueError):  # links in a circle, a NUL
        return False
    return file.suffix == ".toml" and file.is_relative_to(folder)


def _drives(data: Mapping[str, Any]) -> dict[str, str]:
    """Return the drive of each joint, as far as the types of both are right."""
    joints = data.get("joint")
    named = joints.items() if isinstance(joints, dict) else ()
    drives = {name: joint.get("drive") for name, joint in named if isinstance(joint, dict)}
    return {name: drive for name, drive in drives.items() if isinstance(drive, str)}


def _saved(edit: RobotFileText) -> dict[str, Any]:
    try:
        backup = edit.save()
    except FileChanged:
        return {"changed": CHANGED}
    except EditError as error:
        return {"unwritable": str(error)}
    return {"backup": str(backup), "sha256": edit.sha256}


def main() -> None:
    """Answer one request."""
    answer = carry_out(json.load(sys.stdin))
    json.dump(answer, sys.stdout, allow_nan=False)


if __name__ == "__main__":
    main()
