# SPDX-License-Identifier: Apache-2.0
"""Writes the files that follow from api/*.h alone: words for the bits of the core and the records
that it shows (both for programs without the core, in daemon/motord/api), and the tables of
docs/state-page.md. An installed motord has no headers. `--check` only reports whether the files are
up to date."""

import re
import sys
import textwrap
from pathlib import Path

HERE = Path(__file__).resolve().parent
HEADERS = "".join(path.read_text(encoding="utf-8") for path in sorted(HERE.glob("api/*.h")))
WORDS = '''# SPDX-License-Identifier: Apache-2.0
"""Words for the bits of the core, by bit. csrc/build_api.py writes this file from csrc/api/api.h,
which has the meaning of each."""
'''
RECORDS = '''# SPDX-License-Identifier: Apache-2.0
"""What the core shows after a tick, as plain Python values. csrc/build_api.py writes this file from
the structures of csrc/api: the state page is decoded by these names, in their order."""

from __future__ import annotations

from dataclasses import dataclass

I64 = int
U64 = int
U32 = int
Doubles3 = tuple[float, ...]
Doubles6 = tuple[float, ...]
Doubles8 = tuple[float, ...]
Stamps8 = tuple[int, ...]
Reasons = tuple[str, ...]
Faults = tuple[str, ...]
FirstFault = str
DeratedBy = str
GyroState = str
RestWord = str
'''
CLASSES = (
    ("joint_state", "JointSnapshot", "State of one joint. NaN, None: not reported by its drive."),
    ("joint_state", "JointStatus", "A JointSnapshot, as the answer of `status` has it."),
    ("imu_state", "ImuSnapshot", "IMU in the base's x, y, z. NaN: not measured, or unknown yet."),
    ("imu_state", "ImuStatus", "An ImuSnapshot, as the answer of `status` has it."),
    ("feedback_doubt", "DoubtSnapshot", "Why a fault says that the feedback is not believed."),
    ("derating_shown", "DeratingSnapshot", "The derating of the joint that slows the base most."),
    ("speed_loop_shown", "SpeedLoopSnapshot", "One wheel's speed loop: torque in N m, or duty."),
    ("robot_state", "PlainSnapshot", "State of the robot as a whole, without its sub-structures."),
    ("lateral_state", "LateralSnapshot(PlainSnapshot)", "Adds the values of motion sideways."),
    ("steering_state", "SteeringSnapshot(LateralSnapshot)", "Adds joints that take positions."),
    ("rest_shown", "RestSnapshot(SteeringSnapshot)", "Adds whether the robot rests."),
    ("counters_shown", "CountersSnapshot(RestSnapshot)", "Adds what is wrong with counters."),
)
KINDS = {
    "int64_t": (8, "I64"), "uint64_t": (8, "U64"), "uint32_t": (4, "U32"), "double": (8, "float"),
}  # fmt: skip
MEANINGS = {
    "1: ": "bool",
    "1, 0, or 2: the drive cannot say": "bool | None",
    "REASON_*": "Reasons",
    "FAULT_*, ": "Faults",
    "FAULT_*; 0: there is none": "FirstFault",
    "GYRO_*": "GyroState",
    "DERATED_BY_*": "DeratedBy",
    "REST_*": "RestWord",
}
"""Beginning of a field's comment → type of the field in Python."""
JSON = {
    "I64": "int = 0",
    "U32": "int = 0",
    "float": "float | None = None",
    "Doubles3": "tuple[float | None, ...] = ()",
    "bool": "bool = False",
    "bool | None": "bool | None = None",
    "GyroState": 'str = ""',
}
"""Type in Python → type and default in an answer, which may be another version's."""


def words() -> str:
    """Return the content of words.py."""
    text = WORDS
    for table, prefix in (("REASONS", "REASON"), ("FAULTS", "FAULT")):
        found = re.findall(rf"^    {prefix}_(\w+) = 1U? << (\d+),", HEADERS, re.MULTILINE)
        rows = "".join(f'    {bit}: "{name.lower()}",\n' for name, bit in found)
        text += f"\n{table} = {{\n{rows}}}\n"
    return text


def number(name: str) -> str:
    """Return the value of a name of an enum; other texts unchanged."""
    found = re.search(rf"\b{name} = (\d+)", HEADERS) if name else None
    return found[1] if found else name


def fields(struct: str) -> list[tuple[str, str, str, str]]:
    """Return type, name, count of an array and comment of each field."""
    body = re.search(rf"typedef struct {{\n((?: .*\n)*)}} {struct};", HEADERS)[1]
    field = r"(\w+)\s+(\w+)(?:\[(\w+)\])?;(?: */\*((?s:.*?))\*/)?"
    if others := re.sub(field, "", body).strip():
        sys.exit(f"{struct}: {others} is no field with its comment behind it")
    return [
        (kind, name, number(count), re.sub(r"\s*\n[ *]*", " ", comment).strip())
        for kind, name, count, comment in re.findall(field, body)
    ]


def records() -> str:
    """Return the content of records.py."""
    text = f"{RECORDS}PAGE_LAYOUT_VERSION = {number('PAGE_LAYOUT_VERSION')}\n"
    for struct, name, meaning in CLASSES:
        text += "\n\n@dataclass(frozen=True, slots=True, kw_only=True)\n"
        text += f'class {name}:\n    """{meaning}"""\n\n'
        for kind, field, count, comment in fields(struct):
            if kind in KINDS and field != "joint_count":
                key = next((key for key in MEANINGS if comment.startswith(key)), "")
                array = f"{'Stamps' if kind == 'int64_t' else 'Doubles'}{count}"
                python = array if count else MEANINGS.get(key, KINDS[kind][1])
                line = f"    {field}: {JSON[python] if name.endswith('Status') else python}"
                if note := comment.removeprefix(key):
                    line = textwrap.fill(f"{line}  # {note}", 100, subsequent_indent="    # ")
                text += f"{line}\n"
    return text


def size(kind: str) -> int:
    """Return the size in bytes: csrc/core/snapshot.h makes sure that there is no padding."""
    if kind in KINDS:
        return KINDS[kind][0]
    return sum(size(of) * int(count or 1) for of, _, count, _ in fields(kind))


def table(found: re.Match[str]) -> str:
    """Return the table of a structure of the state page, with the text before it."""
    text, at = f"`{found[1]}`, {size(found[1])} bytes{found[2]}", 0
    for kind, name, count, _ in fields(found[1]):
        text += f"| {at} | {kind}{count and f'[{count}]'} | `{name}` |\n"
        at += size(kind) * int(count or 1)
    return text


def page(text: str) -> str:
    """Return the content of docs/state-page.md."""
    version = rf"\g<1>{number('PAGE_LAYOUT_VERSION')}"
    text = re.sub(r"(layout.version (?:\| )?)\d+", version, text)
    return re.sub(r"`(\w+)`, \d+ bytes((?s:.)*?\|---\|---\|---\|\n)(?:\|.*\n)+", table, text)


def main() -> int:
    """Write or check the files. Return the exit status."""
    api, docs = HERE.parent / "daemon/motord/api", HERE.parent / "docs/state-page.md"
    made = {api / "words.py": words(), api / "records.py": records()}
    made[docs] = page(docs.read_text(encoding="utf-8"))
    status = 0
    for path, text in made.items():
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        if "--check" in sys.argv[1:]:
            print(f"{path} is not as csrc/api: run {Path(__file__).name}", file=sys.stderr)
            status = 1
        else:
            path.write_text(text, encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())
