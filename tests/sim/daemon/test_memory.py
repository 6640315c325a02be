# SPDX-License-Identifier: Apache-2.0
"""The memory that the daemon locks: no thread's whole stack."""

import re

import pytest
from tests.fork_server import started_from_nothing
from tests.sim.daemon_stage import running

from motord.client import ClientError

THREAD_KB_MAX = 1024
"""Largest resident stack of a thread; an ordinary stack has 8 MB."""
_MAPPING = re.compile(r"([0-9a-f]+)-([0-9a-f]+) (\S+) \S+ \S+ (\d+)")


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with started_from_nothing(), running(tmp_path_factory.mktemp("memory")) as stage:
        stage.wait_for("idle")
        yield stage


def stacks_kb(pid):
    """Return the resident size of each stack: an anonymous mapping above a guard page."""
    found, guarded, is_stack = [], None, False
    with open(f"/proc/{pid}/smaps", encoding="ascii") as rows:
        for row in rows:
            if mapping := _MAPPING.match(row):
                begin, end, rights, inode = mapping.groups()
                is_stack = begin == guarded and rights == "rw-p" and inode == "0"
                guarded = end if rights == "---p" else None
            elif is_stack and row.startswith("Rss:"):
                found.append(int(row.split()[1]))
    return found


def test_no_thread_has_its_whole_stack_locked_in_memory(stage):
    if stage.robot.status()["loop"]["policy"] != "SCHED_FIFO":
        pytest.skip("memory is not locked here")
    found = stacks_kb(stage.daemon.pid)
    assert found
    assert max(found) <= THREAD_KB_MAX


@pytest.mark.parametrize("owner", ["a" * 65, "", "a b", "a\n"])
def test_an_owner_has_a_name_of_up_to_64_letters(stage, owner):
    with pytest.raises(ClientError, match="owner"):
        stage.robot.call("release", owner=owner)
    stage.robot.call("release", owner="ä" * 64)
