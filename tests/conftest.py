# SPDX-License-Identifier: Apache-2.0
"""Settings and fixtures of all tests. `MOTORD_RT_DIR` puts another build of the C core first (make
san). Property tests have no deadline: a busy machine is no bug. Each run draws new cases, most of
them in `make san`. Programs that tests start use bytecode: without it, each of some thousand starts
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

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # set in containers
sys.dont_write_bytecode = False

if directory := os.environ.get("MOTORD_RT_DIR"):
    sys.path.insert(0, os.path.abspath(directory))


TESTS = Path(__file__).parent
CPUS = os.cpu_count() or 1
LANES = {"page": max(1, CPUS // 2), "robot": CPUS + CPUS // 2}
"""Numbers of lanes, each with one robot at a time; only "page" lanes run browser pages. A robot is
three to seven programs: with more lanes every one is late, fails, and runs again."""
OTHERS = ("browser", "peers")
"""Folders of tests that need programs of other projects. These tests and those marked long take
longer than all others together."""
OPEN_TO = {"browser": ("page",), "sim": ("page", "robot"), "peers": ("page", "robot")}
LONG_S = {
    "test_partition": 32, "test_calibrate": 24, "test_can_robot": 13, "test_bus_faults": 12,
    "test_demos": 9, "test_commission": 8, "test_ros2_rclpy": 7, "test_pwm_demo": 6,
    "test_fleet": 5, "test_stopping": 5, "test_stood_still": 5, "test_doubted_feedback": 5,
    "test_tune": 5, "test_ros2_fastdds": 5, "test_init": 5, "test_spin_steered": 4,
    "test_stop_under_flood": 4, "test_ros2_package": 4, "test_fuzz_short": 4, "test_dashboard": 4,
    "test_strafe": 3, "test_bus_process": 3, "test_ros2_actions": 3,
}  # fmt: skip
"""Mean duration of a test by file, in s; in all other files of a lane it is USUAL_S."""
USUAL_S = 1.5


@functools.cache
def kind_of(path):
    """Return the folder of tests/ that contains `path` at any depth; empty outside tests/."""
    return path.relative_to(TESTS).parts[0] if path.is_relative_to(TESTS) else ""


def lanes(items):
    """Return the lane of each file that starts robots: files with pages come first, because they
    have the fewest lanes, then the longest files; each goes to the lane with the least work."""
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
    """Return whether to leave out the tests that only `make test-all` runs. A test that you name is
    always run."""
    return config.option.without_long and not config.option.file_or_dir


def pytest_ignore_collect(collection_path, config):
    """Leave out OTHERS with --without-long, and test_tidy.py unless its name is given."""
    left_out = is_without_long(config) and kind_of(collection_path) in OTHERS
    tidy = collection_path.name == "test_tidy.py" and not config.option.file_or_dir
    return True if left_out or tidy else None


def leave_out_long(items, config):
    left_out = [item for item in items if item.get_closest_marker("long")]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if not item.get_closest_marker("long")]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items, config):
    """Keep the tests of a lane, and tests that share a fixture of their file, in one process: mark
    them for `--dist loadgroup`, which reads the mark in this hook. Others go to any process."""
    if is_without_long(config):
        leave_out_long(items, config)
    lane_of = lanes(items)
    for item in items:
        definitions = item._fixtureinfo.name2fixturedefs.values()
        if lane := lane_of.get(item.path):
            item.add_marker(pytest.mark.xdist_group(lane))
        elif any(found[-1].scope == "module" for found in definitions if found):
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
    yield  # other plugins shuffle the tests
    items.sort(key=lambda item: item.path not in lane_of)  # files of lanes take longest: first


GROUP = re.compile(rf"@({'|'.join(LANES)}) \d+$")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_logreport(report):
    """Remove the group from a test's name in the main process: `--last-failed`, and you with a
    copied name, find a failed test with or without groups."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        name = GROUP.sub("", report.nodeid)
        report.nodeid = name.removesuffix("@" + name.partition("::")[0])


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Switch garbage collection off while tests are collected: all objects of this time stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish():
    """Exclude the present objects from garbage collection: seven thousand tests and their modules
    live as long as the process."""
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
    """A context manager in whose block this process gets a descriptor only after closing one."""
    return _no_descriptor_left
