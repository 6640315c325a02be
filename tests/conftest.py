# SPDX-License-Identifier: Apache-2.0
"""What every test folder shares. `MOTORD_RT_DIR` puts another build of the C core first (make san).
Property tests have no deadline: a busy machine is no bug. Each run draws new cases, most of them in
`make san`. Programs that tests start use bytecode: without it, each of some thousand starts
compiles a hundred modules again."""

import contextlib
import functools
import gc
import os
import re
import resource
import sys
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings
from tests import fork_server
from tests.late_machine import pytest_runtest_protocol, pytest_terminal_summary  # noqa: F401  hooks

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # containers set it
sys.dont_write_bytecode = False

if directory := os.environ.get("MOTORD_RT_DIR"):
    sys.path.insert(0, os.path.abspath(directory))


TESTS = Path(__file__).parent
CPUS = os.cpu_count() or 1
LANES = {"page": max(1, CPUS // 2), "robot": CPUS + CPUS // 2}
"""Robots that run at once, and those among them with browser pages. Each is three to seven
programs: with more of them every one is late, fails, and runs again."""
OTHERS = ("browser", "peers")
"""Folders of tests that need programs of other projects. With the tests marked long they take the
machine longer than all the rest."""
OPEN_TO = {"browser": ("page",), "sim": ("page", "robot"), "peers": ("page", "robot")}
LONG_S = {
    "test_partition": 32, "test_calibrate": 24, "test_can_robot": 13, "test_bus_faults": 12,
    "test_demos": 9, "test_commission": 8, "test_ros2_rclpy": 7, "test_pwm_demo": 6,
    "test_fleet": 5, "test_stopping": 5, "test_stood_still": 5, "test_doubted_feedback": 5,
    "test_tune": 5, "test_ros2_fastdds": 5, "test_init": 5, "test_spin_steered": 4,
    "test_stop_under_flood": 4, "test_ros2_package": 4, "test_fuzz_short": 4, "test_dashboard": 4,
    "test_strafe": 3, "test_bus_process": 3, "test_ros2_actions": 3,
}  # fmt: skip
"""Duration of one test of these files; in all other files of a lane it is USUAL_S."""
USUAL_S = 1.5


@functools.cache
def kind_of(path):
    """The folder of tests/ that it is in, at any depth."""
    return path.relative_to(TESTS).parts[0] if path.is_relative_to(TESTS) else ""


def lanes(items):
    """The lane of each file that starts robots: files with pages first, which have the fewest
    lanes, then the longest files, each to the lane with the least work."""
    tests = Counter(item.path for item in items if kind_of(item.path) in OPEN_TO)
    files_s = {path: count * LONG_S.get(path.stem, USUAL_S) for path, count in tests.items()}
    kinds = {path: OPEN_TO[kind_of(path)] for path in tests}
    loads_s = {kind: dict.fromkeys(range(count), 0.0) for kind, count in LANES.items()}
    found = {}
    for path in sorted(tests, key=lambda path: (len(kinds[path]), -files_s[path], path)):
        places = [(loads_s[kind][number], kind, number)
                  for kind in kinds[path] for number in loads_s[kind]]  # fmt: skip
        _, kind, number = min(places)
        loads_s[kind][number] += files_s[path]
        found[path] = f"{kind} {number}"
    return found


def pytest_addoption(parser):
    parser.addoption("--without-long", action="store_true", help="as in make test")


def is_without_long(config):
    """Whether to leave out tests of `make test-all` only; a test that you name is always run."""
    return config.option.without_long and not config.option.file_or_dir


def pytest_ignore_collect(collection_path, config):
    """test_tidy.py is run only by its name, as in `make check`."""
    left_out = is_without_long(config) and kind_of(collection_path) in OTHERS
    tidy = collection_path.name == "test_tidy.py" and not config.option.file_or_dir
    return True if left_out or tidy else None


def leave_out_long(items, config):
    left_out = [item for item in items if item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if not item.get_closest_marker("long")]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items, config):
    """Tests of a lane, and tests that share a fixture of their file, stay in one process of `--dist
    loadgroup`, which looks for the mark in this hook; all others go to any free process."""
    if is_without_long(config):
        leave_out_long(items, config)
    lane_of = lanes(items)
    for item in items:
        definitions = item._fixtureinfo.name2fixturedefs.values()
        if lane := lane_of.get(item.path):
            item.add_marker(pytest.mark.xdist_group(lane))
        elif any(found[-1].scope == "module" for found in definitions if found):
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    yield  # they are shuffled
    items.sort(key=lambda item: item.path not in lane_of)  # the longest begin first


GROUP = re.compile(rf"@({'|'.join(LANES)}) \d+$")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_logreport(report):
    """The main process names a test without its group: so `--last-failed` finds a failed test with
    or without groups, and so do you by a copied name."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        name = GROUP.sub("", report.nodeid)
        report.nodeid = name.removesuffix("@" + name.partition("::")[0])


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """No garbage collection during collection: all that it creates stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish():
    """Seven thousand tests and their modules live as long as the process: the garbage collector
    does not scan them again."""
    gc.collect()
    gc.freeze()


def pytest_configure(config):
    san, fast = os.environ.get("MOTORD_RT_DIR"), os.environ.get("FAST")
    examples = 100 if san else 10 if fast else 15 if config.option.without_long else 50
    settings.register_profile("motord", deadline=None, max_examples=examples)
    settings.load_profile("motord")
    fork_server.install()


@contextlib.contextmanager
def _no_descriptor_left():
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    with open(os.devnull, "rb") as free:
        lowest = free.fileno()
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


@pytest.fixture
def no_descriptor_left():
    """For a block in which this process gets a descriptor only where it has closed another one."""
    return _no_descriptor_left
