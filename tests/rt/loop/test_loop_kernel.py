# SPDX-License-Identifier: Apache-2.0
"""The rights that the kernel gives or refuses the loop, and a loop that is stopped or killed."""

import contextlib
import errno
import json
import mmap
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from _motord_rt import ffi, lib
from tests.rt.small_base import core_config, settings, until

from motord.api.page_file import SHARED, PageInUse, own_page
from motord.realtime import loop as rt
from motord.realtime import permissions

CHILD = Path(__file__).parent / "loop_child.py"
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23  # from linux/capability.h
NAME = f"test-loop-{os.getpid()}"


def command(*arguments: str) -> list[str]:
    return [sys.executable, str(CHILD), *arguments]


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def without_privileges(arguments: list[str]) -> list[str]:
    """Return the command line that runs `arguments` without the capabilities for locked memory and
    real-time priority."""
    status = Path("/proc/self/status").read_text()
    effective = int(status.partition("CapEff:")[2].split()[0], 16)
    if not effective >> CAP_SYS_NICE & 1 and not effective >> CAP_IPC_LOCK & 1:
        return arguments
    if shutil.which("setpriv") is None:
        pytest.skip("without setpriv (util-linux) capabilities cannot be given up")
    return ["setpriv", "--bounding-set=-sys_nice,-ipc_lock", *arguments]


@contextlib.contextmanager
def child(*arguments: str):
    with subprocess.Popen(
        command(*arguments),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment(),
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def thread_status() -> dict[str, str]:
    for task in Path("/proc/self/task").iterdir():
        if (task / "comm").read_text() == "motord-loop\n":
            lines = (task / "status").read_text().splitlines()
            return {key: value.strip() for key, _, value in (line.partition(":") for line in lines)}
    raise AssertionError("no thread is called motord-loop")


def test_signals_go_to_asyncio_and_never_to_the_thread():
    with rt.Loop(core_config(), settings()):
        blocked = int(thread_status()["SigBlk"], 16)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGCHLD, signal.SIGUSR1):
            assert blocked >> (number - 1) & 1
    assert signal.SIGTERM not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def test_the_thread_stays_on_the_cpus_of_the_robot_file():
    cpu = max(os.sched_getaffinity(0))
    if cpu > 63:
        pytest.skip("CPU numbers beyond 63")
    with rt.Loop(core_config(), settings(cpu=(cpu,))) as loop:
        assert thread_status()["Cpus_allowed_list"] == str(cpu)
        assert "affinity" not in loop.status().refusals


def test_a_missing_cpu_is_reported_and_the_loop_runs():
    if (os.cpu_count() or 0) > 63:
        pytest.skip("CPU 63 exists")
    with rt.Loop(core_config(), settings(cpu=(63,))) as loop:
        assert "CPU 63" in loop.status().refusals["affinity"]
        seen = loop.status().ticks
        until(lambda: loop.status().ticks > seen)


def test_without_a_priority_nothing_is_reported_as_refused():
    with rt.Loop(core_config(), settings(priority=0)) as loop:
        status = loop.status()
        assert (status.policy, status.priority) == ("SCHED_OTHER", 0)
        assert status.refusals == {}


def test_the_cpu_is_kept_awake_while_the_loop_runs_and_no_longer():
    def held() -> bool:
        links = (os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.is_symlink())
        return "/dev/cpu_dma_latency" in links

    with rt.Loop(core_config(), settings(hold_dma_latency=True)) as loop:
        if "dma_latency" in loop.status().refusals:
            pytest.skip(loop.status().refusals["dma_latency"])
        assert held()
    assert not held()


def test_without_privileges_it_runs_and_reports_what_was_refused_and_what_to_do():
    done = subprocess.run(
        without_privileges(command("refused")),
        capture_output=True,
        env=environment(),
        text=True,
        timeout=100,
        check=True,
    )
    answer = json.loads(done.stdout)
    assert (answer["policy"], answer["priority"]) == ("SCHED_OTHER", 0)
    assert "RLIMIT_RTPRIO is 0: LimitRTPRIO=80" in answer["refusals"]["scheduler"]
    assert "RLIMIT_MEMLOCK 64 KiB" in answer["refusals"]["memory_lock"]
    assert "LimitMEMLOCK=infinity" in answer["refusals"]["memory_lock"]
    assert answer["ticks"] > 0
    assert answer["page_faults"] == 0
    assert answer["before_the_first_start"] == errno.EPROTO
    assert answer["without_a_descriptor"] == answer["refusals"]


def test_the_first_drive_of_a_process_costs_no_page_fault_even_where_memory_is_not_locked():
    done = subprocess.run(
        command("drive"), capture_output=True, env=environment(), text=True, timeout=100, check=True
    )
    answer = json.loads(done.stdout)
    assert answer["distance_m"] > 0
    assert answer["page_faults"] == 0


def test_a_priority_refused_despite_the_rlimit_is_explained_by_the_group_s_budget(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (99, 99))
    answer = permissions.sentences(permissions.Refused(scheduler=errno.EPERM), priority=80, cpu=())
    assert list(answer) == ["scheduler"]
    assert "RT_GROUP_SCHED" in answer["scheduler"]


def test_every_refusal_has_a_sentence():
    refused = permissions.Refused(
        scheduler=errno.EPERM,
        affinity=errno.EINVAL,
        memory_lock=errno.ENOMEM,
        dma_latency=errno.EACCES,
    )
    answer = permissions.sentences(refused, priority=80, cpu=(2, 3))
    assert set(answer) == {"scheduler", "affinity", "memory_lock", "dma_latency"}
    assert "CPU 2, 3 (EINVAL)" in answer["affinity"]
    assert "EACCES" in answer["dma_latency"]
    assert permissions.sentences(permissions.Refused(), priority=80, cpu=()) == {}


def test_a_stopped_process_skips_its_periods_and_does_not_catch_up():
    with child("run", "100") as process:
        before = json.loads(process.stdout.readline())
        process.send_signal(signal.SIGSTOP)
        stopped = Path(f"/proc/{process.pid}/stat")
        until(lambda: stopped.read_text().rpartition(")")[2].split()[0] == "T")
        asleep_ns = lib.clock_now_ns()
        until(lambda: lib.clock_now_ns() - asleep_ns > 500_000_000)
        process.send_signal(signal.SIGCONT)
        after, _ = process.communicate("go on\n", timeout=60)
    after = json.loads(after)
    assert after["overruns"] - before["overruns"] >= 40
    periods = (after["now_ns"] - after["start_ns"]) // 10_000_000 + 1
    assert after["ticks"] + after["overruns"] <= periods


@pytest.mark.skipif(not SHARED.is_dir(), reason="no /dev/shm here")
class TestSharedPage:
    def test_the_page_lies_in_shared_memory_while_the_loop_runs(self):
        path, state = own_page(NAME), ffi.new("robot_state *")
        with rt.Loop(core_config(), settings(), NAME) as loop, open(path, "rb") as file:
            view = mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ)
            with ffi.from_buffer(view) as shared:
                own = loop.read_state()
                assert lib.page_read(shared, state) == 0
                assert own.tick <= state.tick
                loop.stop()
                assert lib.page_read(shared, state) == 0
                assert rt._snapshot(state).to_json() == loop.read_state().to_json()
        assert not path.exists()
        view.close()
        assert str(path) not in Path("/proc/self/maps").read_text()

    def test_the_page_of_a_living_daemon_is_refused_and_that_of_a_killed_one_taken_over(self):
        with child("page", NAME) as process:
            assert process.stdout.readline() == "running\n"
            with pytest.raises(PageInUse, match=f"process {process.pid}"):
                rt.Loop(core_config(), settings(), NAME).start()
            process.kill()
            process.wait(timeout=60)
        assert (own_page(NAME)).exists()
        with rt.Loop(core_config(), settings(), NAME) as loop:
            assert loop.status().running
        assert not (own_page(NAME)).exists()
