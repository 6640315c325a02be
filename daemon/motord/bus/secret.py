# SPDX-License-Identifier: Apache-2.0
"""Tokens and passwords: kept in files that others cannot read, and compared in constant time."""

from __future__ import annotations

import hmac
import stat
from pathlib import Path

from motord_hal.base import bounded

TOKEN_MIN = 16
SECRET_BYTES_MAX = 65536
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def read_secret(path: Path, at_least: int = 1) -> str:
    """Return the one line of a file. Raises OSError, and ValueError if others may read the file or
    the line is shorter than `at_least`."""
    mode = path.stat().st_mode
    if mode & _OTHERS:
        raise ValueError(f"{path} can be read by others: chmod 600 {path}")
    secret = bounded.read(path, SECRET_BYTES_MAX).decode().strip()
    if len(secret) < at_least:
        raise ValueError(f"{path} holds {len(secret)} characters: at least {at_least}")
    return secret


class Token:
    """The token that every command of a networked input has to show."""

    def __init__(self, path: Path) -> None:
        """Raises the errors of `read_secret`."""
        self._secret = read_secret(path, TOKEN_MIN).encode()

    def fits(self, shown: object) -> bool:
        """Return whether `shown` is the token; a value that is no text is not. Never raises: half a
        surrogate pair, which JSON can hold and UTF-8 cannot, is only a wrong token."""
        if not isinstance(shown, str):
            return False
        return hmac.compare_digest(shown.encode(errors="surrogatepass"), self._secret)
