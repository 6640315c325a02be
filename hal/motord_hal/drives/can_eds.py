# SPDX-License-Identifier: Apache-2.0
"""[eds] of a drive profile: what the drive's electronic data sheet (CiA 306) says of the objects
that the profile names. Types come from there; what is not so is said before any wire."""

from __future__ import annotations

import configparser
import re
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError
from motord_hal.drives.toml_table import Problems, Table

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable

# data type of CiA 301, table 44 → type of a profile
_TYPES = MappingProxyType({2: "i8", 3: "i16", 4: "i32", 5: "u8", 6: "u16", 7: "u32"})
_READ_ONLY = ("ro", "const")
_PDO_MAPPINGS = (range(0x1600, 0x1800), range(0x1A00, 0x1C00))
"""Of RPDOs and TPDOs: CiA 301, 7.5.2.36 and .38."""
_MODE, _MODES = 0x6060, 0x6502
"""Modes of operation; supported drive modes, one bit each, mode 1 is bit 0 (CiA 402-2)."""


def with_eds(values: dict[str, Any], path: Path, problems: Problems) -> dict[str, Any]:
    """The profile with the types that its EDS file says; without [eds] as it is. Raises
    ProfileError with every problem that the two have with each other."""
    if "eds" not in values:
        return values
    root = Table("", values, problems)
    eds = root.table("eds")
    file = path.parent / eds.text("file")
    eds.finish()
    whole = {key: value for key, value in values.items() if key != "eds"}
    dictionary = None if problems.rows else _load(file, problems)
    if dictionary is not None:
        reader = _Reader(file.name, dictionary, problems)
        parent = root.table("object")
        whole["object"] = {
            name: reader.object(name, parent.table(name)) if parent.is_table(name) else None
            for name in parent
        }
        reader.check_steps(root.table("steps"))
    if problems.rows:
        raise ProfileError("\n".join(dict.fromkeys(problems.rows)))
    return whole


def _load(file: Path, problems: Problems) -> ObjectDictionary | None:
    import canopen  # only a robot that has such a drive pays for it

    try:
        bounded.read(file, bounded.DESCRIPTION_BYTES_MAX)
        return canopen.import_od(str(file))
    except OSError as error:
        problems.add("eds.file", f"{file}: cannot be read: {error.strerror}")
    except (configparser.Error, ValueError, KeyError, TypeError) as error:
        text = str(error).replace("\n", " ")
        line = re.search(r"line:? *\[?'? *(\d+)|\[line +(\d+)\]", text)
        where = f":{line.group(1) or line.group(2)}" if line else ""
        problems.rows.append(f"{file}{where}: eds: {text}")
    return None


class _Reader:
    """One EDS file, and the objects of the profile by name."""

    def __init__(self, file: str, dictionary: ObjectDictionary, problems: Problems) -> None:
        self._file, self._dictionary, self._problems = file, dictionary, problems
        self._indices: dict[str, tuple[int, int]] = {}

    def object(self, name: str, table: Table) -> dict[str, object]:
        """The object with its type, and what the drive starts with."""
        given = table.without()
        index, sub = table.integer("index", 0x1000, 0xFFFF), table.integer("sub", 0, 255, 0)
        entry = self._dictionary.get_variable(index, sub)
        if entry is None:
            table.complain("index", f"{index:04X}h:{sub:02X}h is not in {self._file}")
            return given
        self._indices[name] = index, sub
        kind = _TYPES.get(entry.data_type or 0)
        if kind is None:
            table.complain("index", f"{self._file}: has a type that no profile has")
            return given
        if given.get("type", kind) != kind:
            table.complain("type", f'"{given["type"]}" is not "{kind}", as {self._file} has it')
        read_only = entry.access_type in _READ_ONLY
        if read_only and given.get("access", "rw") != "r":
            table.complain("access", f"{self._file}: cannot be written ({entry.access_type})")
        default = {"default": entry.default} if isinstance(entry.default, int) else {}
        return {"type": kind, **default, **given}

    def check_steps(self, steps: Table) -> None:
        """What is mapped into PDOs can be, and the mode is one that the drive has."""
        for step in (one for key in steps for one in steps.tables(key)):
            if "write" not in step or "value" not in step:
                continue
            index, sub = self._indices.get(step.text("write"), (0, 0))
            value = step.integer("value", -(1 << 31), (1 << 32) - 1)
            if sub and any(index in one for one in _PDO_MAPPINGS):
                self._check_mapped(step, value)
            elif index == _MODE:
                self._check_mode(step, value)

    def _check_mapped(self, step: Table, value: int) -> None:
        """Index, sub-index and bits of a mapped object: CiA 301, 7.5.2.36."""
        index, sub, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
        entry: ODVariable | None = self._dictionary.get_variable(index, sub)
        where = f"{index:04X}h:{sub:02X}h"
        if entry is None:
            step.complain("value", f"{where} is not in {self._file}")
        elif not entry.pdo_mappable:
            step.complain("value", f"{self._file}: {where} cannot be mapped into a PDO")
        elif len(entry) != bits:
            step.complain("value", f"{self._file}: {where} has {len(entry)} bits, not {bits}")

    def _check_mode(self, step: Table, mode: int) -> None:
        entry = self._dictionary.get_variable(_MODES, 0)
        modes = entry.default if entry is not None else None
        if isinstance(modes, int) and modes and mode > 0 and not modes >> (mode - 1) & 1:
            step.complain("value", f"{self._file}: the drive has no mode {mode} (6502h)")
