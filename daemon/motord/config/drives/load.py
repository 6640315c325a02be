# SPDX-License-Identifier: Apache-2.0
"""The reader of drive profiles: makes a DriveProfile, or every problem at once, from a TOML file.

docs/drives/README.md explains the format. The tables check each value alone; `check.py` checks what
follows only from several of them together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from motord.config.drives.build import build
from motord.config.drives.check import check_profile
from motord.config.drives.dbc import with_dbc
from motord.config.drives.eds import with_eds
from motord.config.drives.problems import Problems
from motord.config.drives.tables import DriveFile
from motord.config.finding import Finding
from motord.config.problems import ConfigError
from motord.config.reading import Places, all_problems, parse, read_text
from motord.config.schema import drive_schema
from motord_hal.base.errors import ProfileError
from motord_hal.base.nearest import did_you_mean
from motord_hal.base.paths import config_dir
from motord_hal.drives.profile import DriveProfile


def list_profiles(extra_dirs: Iterable[Path] = ()) -> dict[str, Path]:
    """Return the file of every profile by name; a profile in an extra folder replaces the shipped
    one."""
    found: dict[str, Path] = {}
    for folder in (*extra_dirs, config_dir() / "drives"):
        for path in sorted(Path(folder).glob("*.toml")):
            found.setdefault(path.stem, path)
    return dict(sorted(found.items()))


def is_file_name(name: str) -> bool:
    """Return whether a drive is named by its file and not by the name of a shipped profile."""
    return "/" in name or name.endswith(".toml")


def find_profile(name: str, extra_dirs: Iterable[Path] = ()) -> DriveProfile:
    """Return the profile of that name, or of that file where `is_file_name` holds. Raises
    ProfileError."""
    if is_file_name(name):
        return load_profile(Path(name))
    profiles = list_profiles(extra_dirs)
    if name not in profiles:
        known = ", ".join(profiles)
        raise ProfileError(
            f'no drive profile "{name}"{did_you_mean(name, profiles)}; known: {known}'
        )
    return load_profile(profiles[name])


def load_profile(path: Path, counts_per_turn: int | None = None) -> DriveProfile:
    """Read and check one file. Raises one ProfileError with a `file:line: key: problem` row for
    each problem in it.

    `counts_per_turn` replaces that of the file: another encoder on the same drive. Registers in
    "count/s" are speeds by that number, so it has to be known when they are read.
    """
    try:
        text = read_text(path)
        data = parse(path, text)
        if counts_per_turn and isinstance(data.get("motor"), dict):
            data = {**data, "motor": {**data["motor"], "counts_per_turn": counts_per_turn}}
        return _profile(path, data, Places(str(path), text))
    except ConfigError as error:
        raise ProfileError(str(error)) from error


def _profile(path: Path, data: dict[str, Any], places: Places) -> DriveProfile:
    """Return the profile of a file's data. Raises ConfigError."""
    try:
        file = DriveFile.model_validate(data)
        for described in (with_dbc, with_eds):
            data = described(data, file, path, places)
            file = DriveFile.model_validate(data)
    except ValidationError as error:

        def rules(mended: DriveFile) -> Sequence[Finding]:
            return () if mended.dbc or mended.eds else _checked(mended, path)[1]

        problems = all_problems(
            places, data, error, drive_schema(), DriveFile.model_validate, rules
        )
        raise ConfigError(problems) from None
    profile, found = _checked(file, path)
    if found:
        raise ConfigError(places.sorted(found, warnings=False))
    return profile


def _checked(file: DriveFile, path: Path) -> tuple[DriveProfile, list[Finding]]:
    problems = Problems()
    profile = build(file, path, problems)
    check_profile(profile, problems)
    return profile, problems.found
