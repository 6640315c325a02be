# SPDX-License-Identifier: Apache-2.0
"""Builds `_motord_bus` from api_bus.h, as build_ffi.py builds `_motord_rt`. It passes commands from
DDS to the daemon, in the second process, which loads nothing else of csrc/."""

import os
import shlex
from pathlib import Path

from cffi import FFI

HERE = Path(__file__).resolve().parent
SOURCES = sorted((HERE / "bus").glob("*.c"))
SHARED = [HERE / "base" / f"{name}.c" for name in ("clock", "ring")]
FOLDERS = (HERE, HERE / "api", HERE / "base", HERE / "bus")
FLAGS = [
    *("-std=c11", "-O2", "-fvisibility=hidden", "-ffp-contract=off", "-D_GNU_SOURCE"),
    *("-Wall", "-Wextra", "-Werror=implicit-function-declaration"),
]

ffi = FFI()
ffi.cdef((HERE / "api" / "api_bus.h").read_text(encoding="utf-8"))
ffi.set_source(
    "_motord_bus",
    '#include "bus.h"',
    sources=[os.path.relpath(path) for path in (*SOURCES, *SHARED)],
    include_dirs=[os.path.relpath(folder) for folder in FOLDERS],
    depends=[os.path.relpath(path) for path in HERE.rglob("*.h")],
    extra_compile_args=FLAGS + shlex.split(os.environ.get("MOTORD_CFLAGS", "")),
    extra_link_args=shlex.split(os.environ.get("MOTORD_LDFLAGS", "")),
    libraries=["dl", "pthread"],
    py_limited_api=True,
)

if __name__ == "__main__":
    ffi.compile(verbose=True)
