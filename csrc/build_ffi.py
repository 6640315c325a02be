# SPDX-License-Identifier: Apache-2.0
"""Builds `_motord_rt` from api/*.h by cffi in API mode: the C compiler checks the place of every
field.

ABI mode was tried and rejected: it did not notice two swapped fields.
`MOTORD_CFLAGS` adds compiler flags (sanitizers, -Werror in CI).
"""

import os
import shlex
from pathlib import Path

from cffi import FFI

HERE = Path(__file__).resolve().parent
# csrc/bus is another library: build_bus.py
SOURCES = sorted(path for path in HERE.rglob("*.c") if path.parent.name != "bus")
FOLDERS = sorted({path.parent for path in HERE.rglob("*.h")})
# Exact arithmetic on every machine: no fast-math (isnan(NAN) became 0), no fused multiply-add
# (replay compares bit for bit between x86-64 and aarch64). Without errno and traps, which no code
# reads, the values stay the same.
FLAGS = [
    "-std=c11",
    "-O2",
    "-funroll-loops",
    "-fno-tree-vectorize",
    "-fvisibility=hidden",
    "-ffp-contract=off",
    "-fno-fast-math",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-D_GNU_SOURCE",
    "-Wall",
    "-Wextra",
    "-Werror=implicit-function-declaration",
]
LIBRARIES = ["m", "rt"]

ffi = FFI()
HEADERS = (
    "api_clock.h",
    "api_imu.h",
    "api_feedback.h",
    "api_position.h",
    "api_speed_loop.h",
    "api_derating.h",
    "api.h",
    "api_core.h",
    "api_loop.h",
    "api_command.h",
    "line/api_line.h",
    "api_trace.h",
    "line/api_drive.h",
    "line/api_can.h",
    "line/api_board.h",
    "api_encoder.h",
    "line/api_bridge.h",
    "api_journal.h",
)
for header in HEADERS:
    ffi.cdef((HERE / "api" / header).read_text(encoding="utf-8"))
ffi.set_source(
    "_motord_rt",
    '#include "rt.h"',
    sources=[os.path.relpath(path) for path in SOURCES],
    include_dirs=[os.path.relpath(folder) for folder in FOLDERS],
    depends=[os.path.relpath(path) for path in HERE.rglob("*.h")],
    extra_compile_args=FLAGS + shlex.split(os.environ.get("MOTORD_CFLAGS", "")),
    extra_link_args=shlex.split(os.environ.get("MOTORD_LDFLAGS", "")),
    libraries=LIBRARIES,
    py_limited_api=True,
)

if __name__ == "__main__":
    ffi.compile(verbose=True)
