# SPDX-License-Identifier: Apache-2.0
"""[eds] of a drive profile: the drive's electronic data sheet (CiA 306) describes the objects that
the profile names. Types come from there; differences are reported before any wire is used."""

from __future__ import annotations

import configparser
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from motord.config.drives.can_tables import CanObject
from motord.config.drives.problems import Problems
from motord.config.drives.tables import DriveFile, Sequences, WriteStep
from motord.config.problems import ConfigError, Problem
from motord.config.reading import Places
from motord_hal.base import bounded

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable

# data type of CiA 301, table 44 → type of a profile
_TYPES = MappingProxyType({2: "i8", 3: "i16", 4: "i32", 5: "u8", 6: "u16", 7: "u32"})
_READ_ONLY = ("ro", "const")
_PDO_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
"""Objects that map RPDOs and TPDOs: CiA 301, 7.5.2.36 and .38."""
_MODE, _MODES = 0x6060, 0x6502
"""Objects: modes of operation; supported drive modes, one bit each, mode 1 is bit 0 (CiA 402-2)."""


def with_eds(
    data: dict[str, Any], profile: DriveFile, path: Path, places: Places
) -> dict[str, Any]:
    """Return the profile's tables with the types of its EDS file; without [eds] unchanged. Raises
    ConfigError with every problem that the two have with each other."""
    if profile.eds is None:
        return data
    file = path.parent / profile.eds.file
    reader = _Reader(file.name, _load(file), Problems())
    objects = {
        name: reader.object(name, entry, data["object"][name])
        for name, entry in profile.objects.items()
    }
    reader.check_steps(profile.steps)
    if reader.problems.found:
        raise ConfigError(places.sorted(reader.problems.found, warnings=False))
    return {**data, "object": objects}


def _load(file: Path) -> ObjectDictionary:
    """Read an EDS file. Raises ConfigError."""
    import canopen  # imported here, as only a robot with such a drive needs it

    try:
        bounded.read(file, bounded.DESCRIPTION_BYTES_MAX)
        return canopen.import_od(str(file))
    except OSError as error:
        problem = Problem(str(file), 0, "", f"cannot be read: {error.strerror}")
    except (configparser.Error, ValueError, KeyError, TypeError) as error:
        line = re.search(r"line:? *\[?'? *(\d+)|\[line +(\d+)\]", str(error))
        number = int(line.group(1) or line.group(2)) if line else 0
        problem = Problem(str(file), number, "eds", str(error).replace("\n", " "))
    raise ConfigError([problem]) from None


class _Reader:
    """Reader of one EDS file, with the objects of the profile by name."""

    def __init__(self, file: str, dictionary: ObjectDictionary, problems: Problems) -> None:
        self.problems = problems
        self._file, self._dictionary = file, dictionary
        self._indices: dict[str, tuple[int, int]] = {}

    def object(self, name: str, table: CanObject, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the object's table with its type, and its value at power-up."""
        key, index, sub = f"object.{name}", table.index, table.sub
        entry = self._dictionary.get_variable(index, sub)
        if entry is None:
            self.problems.add(f"{key}.index", f"{index:04X}h:{sub:02X}h is not in {self._file}")
            return given
        self._indices[name] = index, sub
        kind = _TYPES.get(entry.data_type or 0)
        if kind is None:
            self.problems.add(f"{key}.index", f"{self._file}: has a type that no profile has")
            return given
        if (table.type or kind) != kind:
            problem = f'"{table.type}" is not "{kind}", as {self._file} has it'
            self.problems.add(f"{key}.type", problem)
        if entry.access_type in _READ_ONLY and table.access != "r":
            problem = f"{self._file}: cannot be written ({entry.access_type})"
            self.problems.add(f"{key}.access", problem)
        default = {"default": entry.default} if isinstance(entry.default, int) else {}
        return {"type": kind, **default, **given}

    def check_steps(self, steps: Sequences) -> None:
        """Check that mapped objects can be mapped into PDOs, and that the drive has the mode."""
        for name in Sequences.model_fields:
            for at, step in enumerate(getattr(steps, name)):
                if not isinstance(step, WriteStep) or step.value is None:
                    continue
                key = f"steps.{name}[{at}].value"
                index, sub = self._indices.get(step.write, (0, 0))
                if sub and any(index in one for one in _PDO_MAPPINGS):
                    self._check_mapped(key, step.value)
                elif index == _MODE:
                    self._check_mode(key, step.value)

    def _check_mapped(self, key: str, value: int) -> None:
        """Check index, sub-index and bits of a mapped object: CiA 301, 7.5.2.36."""
        index, sub, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        entry: ODVariable | None = self._dictionary.get_variable(index, sub)
        where = f"{index:04X}h:{sub:02X}h"
        if entry is None:
            self.problems.add(key, f"{where} is not in {self._file}")
        elif not entry.pdo_mappable:
            self.problems.add(key, f"{self._file}: {where} cannot be mapped into a PDO")
        elif len(entry) != bits:
            self.problems.add(key, f"{self._file}: {where} has {len(entry)} bits, not {bits}")

    def _check_mode(self, key: str, mode: int) -> None:
        entry = self._dictionary.get_variable(_MODES, 0)
        modes = entry.default if entry is not None else None
        if isinstance(modes, int) and modes and mode > 0 and not modes >> (mode - 1) & 1:
            self.problems.add(key, f"{self._file}: the drive has no mode {mode} (6502h)")
