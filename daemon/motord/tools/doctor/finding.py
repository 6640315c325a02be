# SPDX-License-Identifier: Apache-2.0
"""What the doctor finds, and the machine that it looks at: files below one root, so that a test can
plant a machine."""

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
    """A fix that writes one value into one file of the kernel; it lasts until the next start."""

    path: Path
    value: str

    def __str__(self) -> str:
        return f"echo {self.value} | sudo tee {self.path}"

    def apply(self) -> str:
        """Empty, or what it failed by."""
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
        """Empty, or what it failed by."""
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
    """One line of the report."""

    group: str
    """machine, device, extra, drive or daemon."""
    check: str
    """A short name."""
    verdict: Verdict
    text: str
    mend: str = ""
    """A command or a setting."""
    fixes: tuple[Fix, ...] = ()
    """Safe fixes: they move nothing, and what they change has no other user."""

    def to_json(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "group": self.group, "check": self.check, "verdict": self.verdict, "text": self.text,
            "mend": self.mend, "can_fix": bool(self.fixes),
        }  # fmt: skip


class Root:
    """The machine's files. `ask_bit_rate`: the kernel's answer for a CAN interface, bits/s."""

    def __init__(
        self,
        root: Path = Path("/"),
        ask_bit_rate: Callable[[str], int | None] = lambda _: None,
    ) -> None:
        self.root = root
        self.ask_bit_rate = ask_bit_rate

    @property
    def real(self) -> bool:
        """This machine, and no planted one."""
        return self.root == Path("/")

    def path(self, path: str) -> Path:
        """Of an absolute path."""
        return self.root / path.lstrip("/")

    def text(self, path: str) -> str:
        """Without the space around it; empty where it is missing or not ours to read."""
        try:
            found = self.path(path).read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""
        return found.strip("\0 \n\t")

    def number(self, path: str) -> int | None:
        """None: it is missing, or not a number."""
        try:
            return int(self.text(path), 0)
        except ValueError:
            return None

    def glob(self, pattern: str) -> Sequence[Path]:
        """Sorted; empty where nothing fits."""
        try:
            return sorted(self.root.glob(pattern.lstrip("/")))
        except OSError:
            return ()

    def status(self, name: str) -> str:
        """A field of this program's /proc/self/status."""
        rows = self.text("/proc/self/status").splitlines()
        found = [row.partition(":")[2].strip() for row in rows if row.startswith(f"{name}:")]
        return found[0] if found else ""

    def limit(self, name: str) -> str:
        """The soft limit of a row of /proc/self/limits; empty where it is not there."""
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
