# SPDX-License-Identifier: Apache-2.0
"""Change a robot file or some of its keys: comments and order stay, and a file that would not pass
`motord check` is not written."""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import json
import os
import stat
import time
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import tomlkit
from tomlkit.container import Container, OutOfOrderTableProxy
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable, Table

from motord.commission.person import Person
from motord.config import ConfigError, Robot, load_robot
from motord_hal.base import bounded

KeyPath: TypeAlias = tuple[str, ...]
"""Path of a key, such as ("joint", "left", "inverted")."""
_AnyTable: TypeAlias = "Container | Table | InlineTable | OutOfOrderTableProxy"


class EditError(Exception):
    """The file cannot be read or written; the message names it, the cause and the remedy."""


class FileChanged(EditError):
    """The file on disk is no longer the one that was read."""


class RobotFileText:
    """One robot file with its new text, which `save` writes to disk."""

    def __init__(self, path: Path, text: str | None = None) -> None:
        """`text`: the new text; None: that of the file. Raises EditError for an unreadable file."""
        self.path = path.resolve()  # the file itself: `save` must not replace a link to it
        try:
            self._found = bounded.read(self.path)
            self._text = self._found.decode("utf-8-sig") if text is None else text
        except OSError as error:
            raise EditError(f"{path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise EditError(f"{path}: is not UTF-8: {error.reason}") from error

    @property
    def text(self) -> str:
        """The file with all changes."""
        return self._text

    @property
    def changed(self) -> bool:
        """Whether `save` has anything to write."""
        return self.text.encode() != self._found

    @property
    def sha256(self) -> str:
        """SHA-256 of the file on disk, as it was read."""
        return hashlib.sha256(self._found).hexdigest()

    def diff(self) -> str:
        """Return what changes, in the form of `diff -u`; empty: nothing."""
        before, after = self._found.decode(), self.text
        name = self.path.name
        rows = difflib.unified_diff(
            before.splitlines(keepends=True), after.splitlines(keepends=True),
            f"{name} (now)", f"{name} (new)", n=1,
        )  # fmt: skip
        return "".join(row if row.endswith("\n") else f"{row}\n" for row in rows)

    def checked(self) -> Robot:
        """Return the robot that the changed file describes. Raises ConfigError."""
        return load_robot(self.path, text=self.text)

    def save(self) -> Path:
        """Write the file completely or not at all; returns the backup of the old one. Raises
        ConfigError for a text that does not pass, FileChanged if the file is not what was read,
        EditError if it cannot be written."""
        self.checked()
        try:
            if bounded.read(self.path) != self._found:
                raise FileChanged(f"{self.path}: has changed since it was read: run this again")
            backup = self._backup()
            replace_file(self.path, self.text.encode())
        except OSError as error:
            raise EditError(_why_not_written(self.path, error)) from error
        self._found = self.text.encode()
        return backup

    def _backup(self) -> Path:
        stamp = time.strftime("%Y%m%d-%H%M%S")
        for number in range(100):
            again = f"-{number}" if number else ""
            backup = self.path.with_name(f"{self.path.name}.{stamp}{again}.bak")
            try:
                descriptor = os.open(backup, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            except FileExistsError:
                continue
            with open(descriptor, "wb") as file:
                _like(file.fileno(), self.path)
                file.write(self._found)
            return backup
        raise EditError(f"{self.path}: has 100 backups of this second")


class RobotFileEdit(RobotFileText):
    """One robot file whose keys are changed one by one."""

    def __init__(self, path: Path) -> None:
        """Read the file like RobotFileText. Raises ConfigError for a file that does not pass."""
        super().__init__(path)
        self.before = load_robot(self.path)
        self._document = tomlkit.parse(self._text)

    @property
    def text(self) -> str:
        """The file with all changes."""
        return self._document.as_string()

    def get(self, path: KeyPath) -> Any:
        """Return the value that the file gives for a key; None: the file does not give it."""
        value: Any = self._document.unwrap()
        for part in path:
            if not isinstance(value, dict) or part not in value:
                return None
            value = value[part]
        return value

    def set(self, path: KeyPath, value: Any) -> None:
        """Give a key this value, in the table where it belongs. If the value is there already, it
        keeps its spelling. Raises EditError, and changes nothing, if something else would change
        with it."""
        if self.get(path) == value:
            return
        before = self.text
        for new_table in (tomlkit.table, tomlkit.inline_table):
            # tomlkit's own errors, and those of values that are no tables
            with contextlib.suppress(TOMLKitError, LookupError, TypeError, ValueError):
                wanted = _with(tomllib.loads(before), path, value)
                self._put(path, value, new_table)
                if _meaning(tomllib.loads(self.text)) == _meaning(wanted):
                    return
            self._document = tomlkit.parse(before)
        where = ".".join(path[:-1])
        raise EditError(
            f"{self.path}: {'.'.join(path)}: cannot be set as the file is written: give {where} a "
            f"table of its own, [{where}], by hand, and run this again"
        )

    def _put(self, path: KeyPath, value: Any, new_table: Callable[[], Table | InlineTable]) -> None:
        *parents, key = path
        table: _AnyTable = self._document
        for part in parents:
            if part not in table:
                table[part] = new_table()
            table = table[part]
        if key in table or not isinstance(table, Table):
            table[key] = value
            return
        tail = _tail(table.value)
        table[key] = value
        table.value.body.extend(tail)

    def update(self, values: Mapping[KeyPath, Any]) -> None:
        """Call `set` for each key."""
        for path, value in values.items():
            self.set(path, value)


def _with(values: dict[str, Any], path: KeyPath, value: Any) -> dict[str, Any]:
    """Return the values with that value set at the path."""
    table = values
    for part in path[:-1]:
        table = table.setdefault(part, {})
    table[path[-1]] = value
    return values


def _meaning(values: dict[str, Any]) -> str:
    """Return a text that is equal for files of equal meaning, in any order of keys; NaN equals
    NaN."""
    return json.dumps(values, sort_keys=True, default=str)


def replace_file(path: Path, content: bytes) -> None:
    """Replace a file by these bytes, completely or not at all, with the mode and owner that it has.
    Raises OSError."""
    new = path.with_name(f".{path.name}.{os.getpid()}.new")
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with open(descriptor, "wb") as file:
            _like(file.fileno(), path)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def write_new(path: Path, content: bytes) -> None:
    """Create a file that does not exist yet. Raises EditError."""
    try:
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError as error:
        raise EditError(f"{path}: is there already: name another file") from error
    except OSError as error:
        raise EditError(_why_not_written(path, error)) from error


def _like(descriptor: int, path: Path) -> None:
    """Give the file the mode and owner of `path`; if there is no such file, mode 0644."""
    try:
        found = path.stat()
    except FileNotFoundError:
        os.fchmod(descriptor, 0o644)
        return
    if (found.st_uid, found.st_gid) != (os.geteuid(), os.getegid()):
        try:
            os.fchown(descriptor, found.st_uid, found.st_gid)
        except PermissionError:
            # a file with passwords of buses must not become readable to another group
            os.fchmod(descriptor, stat.S_IMODE(found.st_mode) & 0o600)
            return
    os.fchmod(descriptor, stat.S_IMODE(found.st_mode))


def _why_not_written(path: Path, error: OSError) -> str:
    if isinstance(error, PermissionError):
        return (
            f"{path}: cannot be written: this user may not write in {path.parent}: run this with "
            f"sudo, or copy the file to a folder of yours and run motord by the copy"
        )
    return f"{path}: cannot be written: {error.strerror}"


def _tail(body: Container) -> list[Any]:
    """Remove and return the blank lines and comments after the last key, so that a new key comes
    before them. Empty if tables follow, whose places tomlkit keeps by number."""
    if any(isinstance(item, Table) for _, item in body.body):
        return []
    tail: list[Any] = []
    while body.body and body.body[-1][0] is None:
        tail.insert(0, body.body.pop())
    return tail


def write_asking(person: Person, edit: RobotFileText, *, dry_run: bool = False) -> Path | None:
    """Show the difference, confirm, write; returns the backup of the old file. None: nothing was
    written. Raises ConfigError, EditError, Aborted."""
    if not edit.changed:
        person.show(f"{edit.path}: nothing changes")
        return None
    person.difference(edit.diff().rstrip())
    if dry_run or not person.confirm(f"Write {edit.path}?"):
        person.show("nothing was written")
        return None
    backup = edit.save()
    person.show(f"{edit.path}: written; the old file is {backup.name}")
    return backup


__all__ = [
    "ConfigError", "EditError", "FileChanged", "KeyPath", "RobotFileEdit", "RobotFileText",
    "replace_file", "write_asking", "write_new",
]  # fmt: skip
