# SPDX-License-Identifier: Apache-2.0
"""Owns the state page of a robot as a daemon does: `page_writer NAME [USER]`. It writes a snapshot
for each line on its standard input, and answers with a line. USER: the user it becomes first."""

import mmap
import os
import sys

from _motord_rt import ffi, lib

from motord.api.page_file import PageFile

with PageFile.open(sys.argv[1]) as file:
    os.truncate(file.fd, lib.PAGE_BYTES)
    view = mmap.mmap(file.fd, lib.PAGE_BYTES)
    raw = ffi.from_buffer("char[]", view, require_writable=True)
    assert lib.page_init(raw) == 0
    for user in map(int, sys.argv[2:]):
        os.setuid(user)
    state = ffi.new("robot_state *")
    print("there", flush=True)
    for _ in sys.stdin:
        state.stamp_ns, state.tick = lib.clock_now_ns(), state.tick + 1
        lib.page_write(raw, state)
        print("written", flush=True)
