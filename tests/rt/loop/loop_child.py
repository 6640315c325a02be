# SPDX-License-Identifier: Apache-2.0
"""A process that runs a loop, for tests that take its privileges, stop it or kill it."""

import ctypes
import dataclasses
import json
import resource
import sys
from pathlib import Path

from tests.rt.small_base import LIMITS, arm, core_config, report_wheels, settings, until

from motord.realtime import loop as rt
from motord_hal.realtime.exchange import now_ns

MADV_DONTNEED, MADV_DONTDUMP = 4, 16  # from asm-generic/mman-common.h


def refused() -> None:
    """Run a loop without any privileges; print its status as JSON."""
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (64 * 1024, 64 * 1024))
    loop = rt.Loop(core_config(), settings(lock_memory=True))
    code = 0
    try:
        loop.read_state()
    except OSError as error:
        code = error.errno
    with loop:
        until(lambda: loop.status().ticks > 600)
        answer = dataclasses.asdict(loop.status())
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))  # no descriptor is left
        again = loop.status().refusals
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    print(json.dumps(answer | {"before_the_first_start": code, "without_a_descriptor": again}))


def forget_code(of: str) -> None:
    """Drop a loaded library's code from the page table, and cut its mapping into single pages, so
    that the kernel maps no neighbouring pages: each first use of a page is a fault."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.madvise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    page_bytes = resource.getpagesize()
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, rights, *_, path = line.split(maxsplit=5)
        if of in path and "x" in rights:
            start, end = (int(edge, 16) for edge in span.split("-"))
            for page in range(start, end, 2 * page_bytes):
                assert libc.madvise(page, page_bytes, MADV_DONTDUMP) == 0
            for page in range(start, end, page_bytes):
                assert libc.madvise(page, page_bytes, MADV_DONTNEED) == 0


def drive() -> None:
    """Print the page faults of a process's first drive, which runs all code for the first time."""
    loop = rt.Loop(core_config(), settings(lock_memory=False))
    forget_code("_motord_rt")
    forget_code("libm.so")
    with loop:
        lease = arm(loop)
        lease.send(0.5, 0.5)
        for count in range(50):
            report_wheels(count)
            loop.beat()
            seen = loop.status().ticks
            until(lambda seen=seen: loop.status().ticks > seen)
        state = loop.read_state()
        loop.put_control(rt.Control(armed=True, estop=True, limits=LIMITS))
        until(lambda: "estop" in loop.read_state().faults)
        seen = loop.status().ticks + 600  # the loop counts page faults in every 256th tick
        until(lambda: loop.status().ticks > seen)
        answer = {"page_faults": loop.status().page_faults, "distance_m": state.distance_m}
    print(json.dumps(answer))


def run(rate_hz: str) -> None:
    """Print the counters, wait for a line, let some ticks pass, print them again."""
    start_ns = now_ns()
    with rt.Loop(core_config(), settings(rate_hz=float(rate_hz))) as loop:
        for wait in (True, False):
            status = loop.status()
            answer = {"ticks": status.ticks, "overruns": status.overruns}
            print(json.dumps(answer | {"start_ns": start_ns, "now_ns": now_ns()}), flush=True)
            if wait:
                sys.stdin.readline()
                seen = loop.status().ticks + 3
                until(lambda seen=seen: loop.status().ticks > seen)


def page(name: str) -> None:
    """Hold the page of that name until killed."""
    with rt.Loop(core_config(), settings(), name):
        print("running", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    {"refused": refused, "drive": drive, "run": run, "page": page}[sys.argv[1]](*sys.argv[2:])
