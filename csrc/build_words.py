# SPDX-License-Identifier: Apache-2.0
"""Writes the words for the bits of the core, daemon/motord/api/words.py, from api/api.h. Programs
without the core need them, and where motord is installed there is no header. `--check` only reports
whether the file is as the header."""

import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
HEADER = HERE / "api/api.h"
WORDS = HERE.parent / "daemon/motord/api/words.py"
BEGIN = '''# SPDX-License-Identifier: Apache-2.0
"""Words for the bits of the core, by bit. csrc/build_words.py writes this file from csrc/api/api.h,
which has the meaning of each."""
'''


def made(header: str) -> str:
    """The file for the text of the header."""
    text = BEGIN
    for table, prefix in (("REASONS", "REASON"), ("FAULTS", "FAULT")):
        found = re.findall(rf"^    {prefix}_(\w+) = 1U? << (\d+),", header, re.MULTILINE)
        rows = "".join(f'    {bit}: "{name.lower()}",\n' for name, bit in found)
        text += f"\n{table} = {{\n{rows}}}\n"
    return text


def main() -> int:
    """The exit status."""
    wanted = made(HEADER.read_text(encoding="utf-8"))
    if WORDS.exists() and WORDS.read_text(encoding="utf-8") == wanted:
        return 0
    if "--check" in sys.argv[1:]:
        print(f"{WORDS} is not as {HEADER}: run {Path(__file__).name}", file=sys.stderr)
        return 1
    WORDS.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
