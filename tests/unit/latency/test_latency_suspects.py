# SPDX-License-Identifier: Apache-2.0
"""The cause of late ticks, from records that a kernel could have written."""

import struct

import pytest

from motord.realtime.types import LateTick
from motord.tools.latency.causes.activity import Thread, Threads, counts
from motord.tools.latency.causes.suspects import Case
from motord.tools.latency.causes.switches import Switches

LOOP, HOG, CPU = 100, 200, 1
US = 1000
MISC_SWITCH_OUT = 1 << 13


def record(kind, body, *, thread, time_ns, cpu=CPU, misc=0):
    """Return a record in the layout of perf_event_open(2), with sample_id of TID, TIME and CPU."""
    data = body + struct.pack("=IIQII", thread, thread, time_ns, cpu, 0)
    return struct.pack("=IHH", kind, misc, 8 + len(data)) + data


def switch_in(thread, time_ns, cpu=CPU):
    return record(15, struct.pack("=II", 0, 0), thread=thread, time_ns=time_ns, cpu=cpu)


def fork(parent, child, time_ns):
    return record(
        7, struct.pack("=IIIIQ", child, parent, child, parent, time_ns),
        thread=parent, time_ns=time_ns,
    )  # fmt: skip


def named(thread, name, time_ns=0):
    body = struct.pack("=II", thread, thread) + name.encode().ljust(16, b"\0")
    return record(3, body, thread=thread, time_ns=time_ns)


def late(deadline_ns, wake_us=1000, work_us=5, **more):
    usual = {"ready_ns": 0, "page_faults": 0, "preemptions": 0, "cpu": CPU, "cpu_before": CPU}
    stages = (wake_us * US, work_us * US, 0, 0, 0)
    return LateTick(deadline_ns=deadline_ns, stage_ns=stages, **(usual | more))


def hog(**more):
    usual = {
        "thread": HOG, "process": HOG, "name": "hog", "policy": "SCHED_OTHER", "priority": 0,
        "of_kernel": False,
    }  # fmt: skip
    return Thread(**(usual | more))


def held_by_hog(begin_us=0, end_us=2000):
    switches = Switches()
    switches.read(switch_in(HOG, begin_us * US) + switch_in(LOOP, end_us * US))
    return switches


def culprit(switches, ticks, *threads, priority=80, grown=None):
    case = Case(LOOP, priority, 50.0, {one.thread: one for one in threads})
    case.add(ticks, grown or {}, 1.0, switches)
    return case.verdict(1.0, switches, 0, "").culprit


def test_a_thread_holds_a_processor_until_the_next_one_is_switched_in():
    switches = held_by_hog(begin_us=10, end_us=60)
    assert switches.held(CPU, 20 * US, 100 * US) == {HOG: 40 * US, LOOP: 40 * US}
    assert switches.held(CPU, 0, 10 * US) == {}
    assert switches.held(0, 0, 100 * US) == {}
    switches.forget(50 * US)
    assert switches.held(CPU, 20 * US, 100 * US) == {HOG: 40 * US, LOOP: 40 * US}
    switches.forget(70 * US)
    assert switches.held(CPU, 20 * US, 100 * US) == {LOOP: 40 * US}


def test_a_switch_out_is_no_second_holder_and_a_broken_record_ends_the_reading():
    switches = Switches()
    out = record(15, struct.pack("=II", 7, 7), thread=HOG, time_ns=5, misc=MISC_SWITCH_OUT)
    switches.read(out + switch_in(LOOP, 6) + struct.pack("=IHH", 15, 0, 0) + switch_in(HOG, 7))
    assert switches.on == {CPU: [(6, LOOP)]}


def test_names_parents_and_forks_come_from_the_records():
    switches = Switches()
    switches.read(named(HOG, "sh") + fork(HOG, 300, 1) + fork(HOG, 301, 2) + named(301, "true", 3))
    assert switches.parent == {300: HOG, 301: HOG}
    assert switches.forks == {HOG: 2}
    assert (switches.name[300], switches.name[301]) == ("sh", "true")


def test_records_of_several_processors_count_in_the_order_of_their_times():
    switches = Switches()
    switches.read(named(300, "true", 3), named(HOG, "sh") + fork(HOG, 300, 2))
    assert switches.name[300] == "true"


def test_a_real_time_thread_above_the_loop_is_named_with_its_priority():
    found = culprit(held_by_hog(), [late(0)], hog(policy="SCHED_FIFO", priority=90))
    assert (found.kind, found.process, found.share) == ("real-time thread", HOG, 1.0)
    assert "SCHED_FIFO 90" in found.words
    assert "below 80" in found.cure


def test_a_real_time_thread_below_the_loop_is_in_the_kernel():
    assert culprit(held_by_hog(), [late(0)], hog(policy="SCHED_FIFO", priority=70)).kind == (
        "kernel work"
    )


def test_children_are_charged_to_the_program_that_starts_them():
    switches = Switches()
    children = range(300, 320)
    switches.read(named(HOG, "sh"))
    for number, child in enumerate(children):
        at = 1000 * number * US
        switches.read(fork(HOG, child, at) + switch_in(child, at) + switch_in(LOOP, at + 900 * US))
    ticks = [late(1000 * number * US, wake_us=900) for number in range(len(children))]
    found = culprit(switches, ticks)
    assert (found.kind, found.process, found.name) == ("fork", HOG, "sh")
    assert found.share == pytest.approx(1.0)
    assert "20 processes a second" in found.words


def test_a_page_faulting_thread_is_named_by_its_rate():
    found = culprit(held_by_hog(), [late(0)], hog(first=(0.0, 0), last=(2.0, 20_000)))
    assert found.kind == "page faults"
    assert "10000 page faults a second" in found.words


def test_without_a_real_time_priority_the_loop_waits_like_any_program():
    assert culprit(held_by_hog(), [late(0)], hog(), priority=0).kind == "no real-time priority"


@pytest.mark.parametrize(
    ("kind", "tick", "grown"),
    [
        ("page faults of the loop", late(0, page_faults=3), {}),
        ("hypervisor", late(0), {("steal", CPU, ""): 1}),
        ("timer", late(0), {}),
        ("tick", late(0, wake_us=1, work_us=400), {}),
    ],
)
def test_a_late_tick_without_a_holder_has_its_own_cause(kind, tick, grown):
    assert culprit(Switches(), [tick], grown=grown).kind == kind


def test_an_interrupt_that_comes_with_late_ticks_is_named():
    case = Case(LOOP, 80, 50.0, {})
    case.add([], {("interrupt", CPU, "33: eth0"): 10}, 1.0, Switches())
    case.add([late(0)], {("interrupt", CPU, "33: eth0"): 9000}, 1.0, Switches())
    found = case.verdict(2.0, Switches(), 0, "").culprit
    assert (found.kind, found.name) == ("interrupt", "interrupt 33: eth0")


def test_a_short_wait_for_another_thread_is_not_blamed_on_it():
    found = culprit(held_by_hog(begin_us=0, end_us=100), [late(0, wake_us=1000)], hog())
    assert found.kind == "timer"


def test_without_records_a_wait_for_the_processor_has_an_unknown_culprit():
    case = Case(LOOP, 80, 50.0, {})
    case.add([late(0, ready_ns=900 * US)], {}, 1.0, None)
    found = case.verdict(1.0, None, 0, "root is needed")
    assert found.culprit.kind == "unknown"
    assert found.note == "root is needed"
    assert found.tags == {"ready without a CPU": 1}


def test_without_a_late_tick_there_is_no_culprit():
    case = Case(LOOP, 80, 50.0, {})
    case.add([], {}, 1.0, Switches())
    assert case.verdict(1.0, Switches(), 0, "").culprit is None


def test_counters_are_read_as_the_kernel_writes_them(tmp_path):
    files = {
        "proc/interrupts": "      CPU0  CPU1\n 33:  5  7  IO-APIC  3-edge  eth0\nLOC: 1 2 Local\n",
        "proc/softirqs": "      CPU0  CPU1\n NET_RX:  4  6\n",
        "proc/stat": "cpu  1 2 3 4 5 6 7 8 0 0\ncpu1 1 2 3 4 5 6 7 9 0 0\n",
        "sys/devices/system/cpu/cpu1/cpufreq/stats/total_trans": "12\n",
        "proc/7/status": "Name:\tmy (hog)\nTgid:\t6\nPPid:\t2\n",
        "proc/7/task/7/stat": "7 (my (hog) x) S 2 " + " ".join(str(n) for n in range(5, 53)) + "\n",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = counts(tmp_path)
    assert found["interrupt", 1, "33 IO-APIC 3-edge eth0"] == 7
    assert found["softirq", 0, "NET_RX"] == 4
    assert found["steal", 1, ""] == 9
    assert found["frequency", 1, ""] == 12
    thread = Threads(tmp_path).look(7)
    assert (thread.name, thread.process, thread.of_kernel) == ("my (hog)", 6, True)
    # fields 10, 12, 40 and 41 of /proc/PID/stat: proc(5)
    assert thread.first[1] == 10 + 12
    assert (thread.priority, thread.policy) == (40, "policy 41")


def test_a_machine_without_these_files_counts_nothing(tmp_path):
    assert counts(tmp_path) == {}
    assert Threads(tmp_path).look(7) is None
