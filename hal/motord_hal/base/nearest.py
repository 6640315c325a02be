# SPDX-License-Identifier: Apache-2.0
"""Search for the word that was probably meant, for every "did you mean"."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

ALIKE = 0.6
"""Least similarity of two words: difflib's own default for "close" (SequenceMatcher.ratio)."""


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that was probably meant; None: no word is close."""
    found = difflib.get_close_matches(word, list(known), n=1, cutoff=ALIKE)
    return found[0] if found else None


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ` (did you mean "x"?)`, or "" if no word is close."""
    near = nearest(word, known)
    return f' (did you mean "{near}"?)' if near else ""
