# SPDX-License-Identifier: Apache-2.0
"""The findings of the doctor, and access to the machine that it checks. All files are below one
root folder, so that a test can put the files of another machine there."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

Verdict = Literal["ok", "warn", "fail"]
FIX_WITHIN_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Write:
    """A fix that writes a value to a file of the kernel; it lasts until the machine restarts."""

    path: Path
    value: str

    def __str__(self) -> str:
        return f"echo {self.value} | sudo tee {self.path}"

    def apply(self) -> str:
        """Apply the fix. Return an empty string, or the error."""
        try:
            self.path.write_text(f"{self.value}\n", encoding="ascii")
        except OSError as error:
            return f"{self.path}: {error.strerror} (run motord doctor --fix with sudo)"
        return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A fix that runs one command."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"sudo {' '.join(self.words)}"

    def apply(self) -> str:
        """Apply the fix. Return an empty string, or the error."""
        try:
            done = subprocess.run(
                self.words, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                timeout=FIX_WITHIN_S, check=False,
            )  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
        return "" if done.returncode == 0 else done.stderr.strip() or f"exit {done.returncode}"


Fix = Write | Run


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """The result of one check: a line of the report."""

    group: str
    """"machine", "device", "extra", "drive" or "daemon"."""
    check: str
    """Short name of the check."""
    verdict: Verdict
    text: str
    mend: str = ""
    """A command or a setting that solves the problem; empty: there is no problem."""
    fixes: tuple[Fix, ...] = ()
    """Fixes that are safe to apply: they move nothing, and no other program uses what they
    change."""

    def to_json(self) -> dict[str, Any]:
        """Return the finding as a JSON object."""
        return {
            "group": self.group, "check": self.check, "verdict": self.verdict, "text": self.text,
            "mend": self.mend, "can_fix": bool(self.fixes),
        }  # fmt: skip


class Root:
    """Reads the machine's files. `ask_bit_rate` returns the bit rate of a CAN interface, bits/s."""

    def __init__(
        self,
        root: Path = Path("/"),
        ask_bit_rate: Callable[[str], int | None] = lambda _: None,
    ) -> None:
        self.root = root
        self.ask_bit_rate = ask_bit_rate

    @property
    def real(self) -> bool:
        """Whether this is the real machine, and not the files of a test."""
        return self.root == Path("/")

    def path(self, path: str) -> Path:
        """Return the place of an absolute path below the root."""
        return self.root / path.lstrip("/")

    def text(self, path: str) -> str:
        """Return a file's text without white space around it; empty if it cannot be read."""
        try:
            found = self.path(path).read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return found.strip("\0 \n\t")

    def number(self, path: str) -> int | None:
        """Return the number in a file; None: it cannot be read, or is not a number."""
        try:
            return int(self.text(path), 0)
        except ValueError:
            return None

    def glob(self, pattern: str) -> Sequence[Path]:
        """Return the paths that match, sorted."""
        try:
            return sorted(self.root.glob(pattern.lstrip("/")))
        except OSError:
            return ()

    def status(self, name: str) -> str:
        """Return a field of this program's /proc/self/status; empty if it is missing."""
        rows = self.text("/proc/self/status").splitlines()
        found = [row.partition(":")[2].strip() for row in rows if row.startswith(f"{name}:")]
        return found[0] if found else ""

    def limit(self, name: str) -> str:
        """Return the soft limit in a row of /proc/self/limits; empty if the row is missing."""
        for row in self.text("/proc/self/limits").splitlines():
            if row.startswith(name):
                return row[len(name) :].split()[0]
        return ""

    def capable(self, number: int) -> bool:
        """Whether this program has a capability (include/uapi/linux/capability.h)."""
        try:
            return bool(int(self.status("CapEff"), 16) >> number & 1)
        except ValueError:
            return False
