# SPDX-License-Identifier: Apache-2.0
"""Explanations of a text that is not TOML: the place, and the likely cause in a sentence."""

from __future__ import annotations

import re
import tomllib

_PLACE = re.compile(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", re.DOTALL)
_TWICE = re.compile(r"Cannot (?:declare|mutate).*|Cannot overwrite a value|Duplicate.*", re.DOTALL)
_HEADER = re.compile(r"\s*\[+\s*([^\]]+?)\s*\]+")
_KEY = re.compile(r"\s*([A-Za-z0-9_.\"' -]+?)\s*=")


def explain_syntax(text: str, error: tomllib.TOMLDecodeError) -> tuple[int, str]:
    """Return the line, and one sentence: column, cause and cure."""
    found = _PLACE.fullmatch(str(error))
    words = found[1] if found else str(error)
    rows = text.splitlines() or [""]
    if found is None or found[2] is None:
        return len(rows), _sentence("the file ends too early", _unfinished(rows))
    line, column = int(found[2]), int(found[3])
    if _TWICE.fullmatch(words):
        return _twice(rows, min(line, len(rows)))
    if line > 1 and not rows[line - 1 : line]:
        line, column = line - 1, len(rows[line - 2]) + 1
    above = next((row for row in reversed(rows[: line - 1]) if row.strip()), "")
    cause = _cause(rows[line - 1])
    if not cause and above.partition("#")[0].rstrip().endswith((",", "[")):
        cause = "the list that begins above is not closed"
    return line, _sentence(f"column {column}: {_plain(words)}", cause)


def _sentence(what: str, cause: str) -> str:
    return f"{what}: {cause}" if cause else what


def _plain(words: str) -> str:
    """Return the message as one line, without Python's notation."""
    return " ".join(words.split()).replace("'\\n'", "at the end of the line")


def _cause(row: str) -> str:
    code = row.partition("#")[0].rstrip()
    value = code.partition("=")[2].strip()
    if decimal := re.fullmatch(r"([+-]?\d+),(\d+)", value):
        return f"a decimal number is written with a point, {decimal[1]}.{decimal[2]}"
    if re.fullmatch(r"True|False", value):
        return f"write {value.lower()} in small letters"
    if code.count('"') % 2 or (value.startswith("'") and value.count("'") % 2):
        return "a string has no closing quote"
    if re.fullmatch(r"[A-Za-z_/.][^\s\"']*", value):
        return f'a string stands in quotes, "{value}"'
    if "=" not in code and re.match(r"\s*[\w.-]+\s*:", code):
        return "a key and its value are joined by =, not by :"
    if code.lstrip().startswith("[") and not code.endswith("]"):
        return "a table's name ends with ]"
    if re.match(r"[+-]?\d[\d.]*\s*[A-Za-zµ°%]", value):
        return "a number has no unit behind it: the unit is in the key's name"
    if not value and "=" in code:
        return "there is no value behind ="
    return ""


def _unfinished(rows: list[str]) -> str:
    for number, row in enumerate(rows, 1):
        if row.count('"""') % 2:
            return f'the string that begins with """ in line {number} may not be closed'
    return "a list, a table or a string is not closed"


def _twice(rows: list[str], line: int) -> tuple[int, str]:
    """Find a table or a key that is there twice: return its second line, and a text with both
    lines."""
    seen: dict[tuple[str, str], int] = {}
    table = ""
    for number, row in enumerate(rows, 1):
        header, key = _HEADER.match(row), _KEY.match(row)
        if header:
            table, name = header[1], ""
        elif key:
            name = key[1]
        else:
            continue
        first = seen.setdefault((table, name), number)
        if first != number and not row.lstrip().startswith("[["):
            what = f"key {name}" if name else f"table [{table}]"
            return number, f"{what} is there twice, in lines {first} and {number}: keep one"
    return line, "this key or table is there already: keep one"
