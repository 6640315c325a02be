# SPDX-License-Identifier: Apache-2.0
"""Reading of files that people write, within limits: no file, however long or deeply nested,
crashes the program or keeps it busy."""

from __future__ import annotations

import errno
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, BinaryIO

TOML_BYTES_MAX = 256 * 1024
"""Limit for TOML files: ten times the longest robot file that is known."""
DESCRIPTION_BYTES_MAX = 16 * 1024 * 1024
"""Limit for DBC and EDS files."""
DEPTH_MAX = 16
"""Limit for nested brackets, and for the parts of a dotted key. Robot files need 4."""
WORD_MAX = 200
"""Greatest number of characters in a number, or in a part of a key without quotes."""

TOKEN = re.compile(
    r'(?P<skip>[ \t\r]+|\#[^\n]*)|(?P<text>"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5}'
    r'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|[^\s"\'\[\]{}=.,\#]+)|(?P<mark>[\n\[\]{}=.,])',
    re.DOTALL,
)
"""A token of a TOML text."""


def opened(path: Path) -> BinaryIO:
    """Open a file for reading. Raises OSError, also for what is no regular file: a named pipe
    without a writer would keep the program waiting for ever, a device gives bytes without end."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), str(path))
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if stat.S_ISREG(os.fstat(fd).st_mode):
        return open(fd, "rb")
    os.close(fd)
    raise OSError(errno.EINVAL, "is not a regular file", str(path))


def regular(path: Path) -> Path:
    """Return the path of a file that a library opens by itself. Raises OSError as `opened`."""
    opened(path).close()
    return path


def read(path: Path, bytes_max: int = TOML_BYTES_MAX) -> bytes:
    """Read a whole file. Raises OSError as `opened`, and if the file is too long."""
    with opened(path) as file:
        found = file.read(bytes_max + 1)
    if len(found) > bytes_max:
        raise OSError(errno.EFBIG, f"has more than {bytes_max} bytes", str(path))
    return found


def toml(text: str) -> dict[str, Any]:
    """Parse TOML. Unlike tomllib.loads alone, which recurses and needs time with the square of a
    key's parts and of a number's digits, it raises TOMLDecodeError also for what is too deep or too
    long."""
    line, problem = 1, ""
    brackets = parts = 0
    for match in TOKEN.finditer(text):
        word = match[0]
        if match.lastgroup == "mark":
            brackets += (word in "[{") - (word in "]}")
            parts = parts + 1 if word == "." else 0
        elif match.lastgroup == "text" and word[0] not in "\"'" and len(word) > WORD_MAX:
            problem = f"a number or key of more than {WORD_MAX} characters"
        if brackets > DEPTH_MAX or parts >= DEPTH_MAX:
            problem = f"more than {DEPTH_MAX} nested brackets, or parts of a key"
        if problem:
            raise tomllib.TOMLDecodeError(f"{problem} (at line {line}, column 1)")
        line += word.count("\n")
    return tomllib.loads(text)
