# SPDX-License-Identifier: Apache-2.0
"""A process that runs a loop, for tests that refuse it things, stop it or kill it."""

import dataclasses
import json
import resource
import sys

from small_base import core_config, settings, until

from motord import rt
from motord_hal.rt import now_ns


def refused() -> None:
    """With no right to anything: what the loop says of itself, as JSON."""
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
        said = dataclasses.asdict(loop.status())
    print(json.dumps(said | {"before_the_first_start": code}))


def run(rate_hz: str) -> None:
    """Say the counters, wait for a line, let some ticks go by, say them again."""
    start_ns = now_ns()
    with rt.Loop(core_config(), settings(rate_hz=float(rate_hz))) as loop:
        for wait in (True, False):
            status = loop.status()
            said = {"ticks": status.ticks, "overruns": status.overruns}
            print(json.dumps(said | {"start_ns": start_ns, "now_ns": now_ns()}), flush=True)
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
    {"refused": refused, "run": run, "page": page}[sys.argv[1]](*sys.argv[2:])
