# SPDX-License-Identifier: Apache-2.0
"""Finds what made ticks late. The lateness of each tick is charged to the threads that had the
processor meanwhile; the activity of such a thread is reported as the reason. Pure; docs/latency.md
has the rules."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from motord.realtime.types import STAGES, LateTick
from motord.tools.latency.causes.activity import Counts, Thread
from motord.tools.latency.causes.switches import Switches

FORKS_PER_S, FAULTS_PER_S = 5.0, 500.0
"""Rates from which forks or page faults are reported as the reason why a thread delays the loop."""
INTERRUPTS_RATIO, INTERRUPTS_PER_S = 3.0, 200.0
"""An interrupt is a suspect if it comes this many times as often in windows with late ticks as in
others, and at least at this rate."""
SHARE_LEAST = 0.02
HELD_PART = 0.25
"""Least part of a tick's lateness for which other threads must have had the processor to be its
cause."""
IDLE = 0
"""Number of the thread that a processor without work runs."""
REAL_TIME = ("SCHED_FIFO", "SCHED_RR")


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspect:
    """A possible cause. `share` is the part of all lateness that is charged to it."""

    kind: str
    name: str
    words: str
    cure: str
    share: float
    process: int | None = None
    """Process number, if the suspect is a program; else None."""

    def to_json(self) -> dict[str, Any]:
        return {
            "kind": self.kind, "name": self.name, "process": self.process, "words": self.words,
            "cure": self.cure, "share": round(self.share, 3),
        }  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The result of the search in one measurement. `tags` counts the late ticks with a page fault,
    with a preemption, with a change of CPU, and those in which the thread was ready but had no CPU.
    `stages` counts the late ticks by their longest stage."""

    late_from_us: float
    late_ticks: int
    late_lost: int
    seconds: float
    stages: Mapping[str, int]
    tags: Mapping[str, int]
    suspects: tuple[Suspect, ...]
    note: str = ""
    """Reason why it is not known which threads had the processors; empty: it is known."""

    @property
    def culprit(self) -> Suspect | None:
        """The suspect with the largest share; None: there is no suspect."""
        return self.suspects[0] if self.suspects else None

    @property
    def late_per_s(self) -> float:
        return (self.late_ticks + self.late_lost) / self.seconds if self.seconds > 0 else 0.0

    def to_json(self) -> dict[str, Any]:
        return {
            "late_from_us": self.late_from_us, "late_ticks": self.late_ticks,
            "late_lost": self.late_lost, "stages": dict(self.stages), "tags": dict(self.tags),
            "suspects": [one.to_json() for one in self.suspects], "note": self.note,
        }  # fmt: skip


@dataclass(slots=True)
class Case:
    """Collects the windows of a measurement. `loop_thread` and `priority` are those of the loop;
    priority 0: SCHED_OTHER."""

    loop_thread: int
    priority: int
    late_from_us: float
    threads: dict[int, Thread] = field(default_factory=dict)
    held_ns: dict[int, float] = field(default_factory=lambda: defaultdict(float))
    """Thread → lateness charged to it."""
    own_ns: Counter[str] = field(default_factory=Counter)
    """Kind of cause → lateness that is charged to no thread."""
    cpus: Counter[int] = field(default_factory=Counter)
    """CPU → number of ticks that were late on it."""
    stages: Counter[str] = field(default_factory=Counter)
    tags: Counter[str] = field(default_factory=Counter)
    late_counts: Counter[tuple[str, int, str]] = field(default_factory=Counter)
    calm_counts: Counter[tuple[str, int, str]] = field(default_factory=Counter)
    late_s: float = 0.0
    calm_s: float = 0.0
    ticks: int = 0

    def add(
        self, late: Sequence[LateTick], grown: Counts, span_s: float, switches: Switches | None
    ) -> set[int]:
        """Add a window: its late ticks, and the growth of the kernel's counters. Return the threads
        that are charged for these ticks."""
        if late:
            self.late_s += span_s
        else:
            self.calm_s += span_s
        (self.late_counts if late else self.calm_counts).update(grown)
        holders: set[int] = set()
        for tick in late:
            self.ticks += 1
            self._tag(tick)
            others = self._others(tick, switches)
            held_ns, late_ns = sum(others.values()), sum(tick.stage_ns)
            if held_ns >= HELD_PART * late_ns:
                for thread, span_ns in others.items():
                    self.held_ns[thread] += late_ns * span_ns / held_ns
                holders |= others.keys()
            else:
                stolen = grown.get(("steal", tick.cpu_before, ""), 0) > 0
                self.own_ns[_own_kind(tick, stolen=stolen)] += late_ns
        return holders

    def _tag(self, tick: LateTick) -> None:
        self.stages[STAGES[max(range(len(STAGES)), key=lambda i: tick.stage_ns[i])]] += 1
        self.cpus[tick.cpu_before] += 1
        self.tags["page fault"] += tick.page_faults > 0
        self.tags["preempted"] += tick.preemptions > 0
        self.tags["other CPU than before"] += tick.cpu != tick.cpu_before
        self.tags["ready without a CPU"] += (tick.ready_ns or 0) > sum(tick.stage_ns) // 2

    def _others(self, tick: LateTick, switches: Switches | None) -> dict[int, int]:
        """Return thread → time that it had the loop's processor between the tick's deadline and its
        end, for threads other than the loop's."""
        if switches is None:
            return {UNKNOWN: min(tick.ready_ns or 0, sum(tick.stage_ns))}
        shares = Counter(switches.held(tick.cpu_before, tick.deadline_ns, tick.woken_ns))
        shares.update(switches.held(tick.cpu, tick.woken_ns, tick.end_ns))
        return {one: ns for one, ns in shares.items() if one not in (IDLE, self.loop_thread)}

    # -------------------------------------------------------------------------------- the verdict
    def verdict(self, seconds: float, switches: Switches | None, lost: int, note: str) -> Verdict:
        """Return the result for all windows."""
        whole_ns = max(sum(self.held_ns.values()) + sum(self.own_ns.values()), 1)
        charged: dict[tuple[str, int], float] = {}
        for thread, span_ns in self.held_ns.items():
            place = self._place(thread, switches, seconds)
            charged[place] = charged.get(place, 0.0) + span_ns / whole_ns
        found = [self._of_thread(place, share, switches, seconds)
                 for place, share in charged.items()]  # fmt: skip
        found += [self._of_kind(kind, span / whole_ns) for kind, span in self.own_ns.items()]
        found.sort(key=lambda one: -one.share)
        return Verdict(
            late_from_us=self.late_from_us,
            late_ticks=self.ticks,
            late_lost=lost,
            seconds=seconds,
            stages={stage: self.stages[stage] for stage in STAGES if self.stages[stage]},
            tags={tag: count for tag, count in self.tags.items() if count},
            suspects=tuple(one for one in found if one.share >= SHARE_LEAST),
            note=note,
        )

    def _place(self, thread: int, switches: Switches | None, seconds: float) -> tuple[str, int]:
        """Return the key by which the lateness of a thread is summed: (kind of cause, process or
        thread)."""
        if thread == UNKNOWN or switches is None:
            return "unknown", UNKNOWN
        known = self.threads.get(thread)
        process = known.process if known else thread
        if known and known.of_kernel:
            return "kernel thread", thread
        if known and self._outranks(known):
            return "real-time thread", thread
        for one in (process, switches.parent.get(process, process)):
            if switches.forks.get(one, 0) >= FORKS_PER_S * seconds:
                return "fork", one
        if known and known.faults_per_s >= FAULTS_PER_S:
            return "page faults", thread
        return "kernel work" if self.priority else "no real-time priority", process

    def _outranks(self, thread: Thread) -> bool:
        if thread.policy == "SCHED_DEADLINE":
            return True
        return thread.policy in REAL_TIME and thread.priority >= self.priority

    def _of_thread(
        self, place: tuple[str, int], share: float, switches: Switches | None, seconds: float
    ) -> Suspect:
        kind, number = place
        known = self.threads.get(number)
        name = (known.name if known else "") or (switches.name.get(number, "") if switches else "")
        process = known.process if known else number
        program = f"{name or 'a program that has ended'} (pid {process})"
        rate = 0.0
        if kind == "fork" and switches is not None:
            rate = switches.forks[number] / seconds
        elif kind == "page faults" and known:
            rate = known.faults_per_s
        policy = f"{known.policy} {known.priority}" if known else ""
        words, cure = _WORDS[kind]
        return Suspect(
            kind=kind,
            name=name,
            words=words.format(program=program, name=name, rate=rate, policy=policy, thread=number),
            cure=cure.format(priority=self.priority),
            share=share,
            process=process if kind in _PROGRAMS else None,
        )

    def _of_kind(self, kind: str, share: float) -> Suspect:
        name = kind
        if kind == "timer":
            name = self._interrupt() or kind
            kind = "interrupt" if name != kind else kind
        words, cure = _WORDS[kind]
        cpus = ", ".join(str(cpu) for cpu, _ in self.cpus.most_common(4))
        frequency = sum(n for (k, _, _), n in self.late_counts.items() if k == "frequency")
        changed = f"; its frequency changed {frequency} times" if frequency else ""
        return Suspect(
            kind=kind, name=name, words=words.format(name=name, cpus=cpus) + changed, cure=cure,
            share=share,
        )  # fmt: skip

    def _interrupt(self) -> str:
        """Return the interrupt that comes more often when ticks are late, on a CPU with late ones;
        "": no such interrupt."""
        worst = ("", 0.0)
        for (kind, cpu, name), count in self.late_counts.items():
            if kind not in ("interrupt", "softirq") or cpu not in self.cpus or self.calm_s == 0.0:
                continue
            late_hz = count / self.late_s
            calm_hz = self.calm_counts[kind, cpu, name] / self.calm_s
            ratio = late_hz / max(calm_hz, 1.0)
            if late_hz >= INTERRUPTS_PER_S and ratio >= INTERRUPTS_RATIO and ratio > worst[1]:
                worst = f"{kind} {name}", ratio
        return worst[0]


def _own_kind(tick: LateTick, *, stolen: bool) -> str:
    """Return the kind of cause of a late tick for which no other thread is charged."""
    if tick.page_faults > 0:
        return "page faults of the loop"
    if stolen:
        return "hypervisor"
    return "timer" if tick.stage_ns[0] >= sum(tick.stage_ns[1:]) else "tick"


UNKNOWN = -1
_PROGRAMS = ("real-time thread", "fork", "page faults", "kernel work", "no real-time priority")
_WORDS = {
    "real-time thread": (
        "{program}, thread {thread}, runs at {policy} and had the CPU when the loop was due",
        "give it a priority below {priority}, or another CPU than the loop (taskset)",
    ),
    "fork": (
        "{program} starts {rate:.0f} processes a second: the kernel copies and frees their memory",
        "let it start fewer processes, or bind it to other CPUs; PREEMPT_RT kernels interrupt this",
    ),
    "page faults": (
        (
            "{program}, thread {thread}, makes {rate:.0f} page faults a second: "
            "the kernel finds it memory"
        ),
        "let it take its memory once, or bind it to other CPUs; PREEMPT_RT kernels interrupt this",
    ),
    "kernel thread": (
        "the kernel's thread {name} had the CPU when the loop was due",
        "see which device it serves; move its interrupt to another CPU (/proc/irq/N/smp_affinity)",
    ),
    "kernel work": (
        "{program} has a lower priority, but was in the kernel, which did not interrupt its work",
        "bind it to other CPUs, or the loop to a CPU of its own (isolcpus=); use PREEMPT_RT",
    ),
    "no real-time priority": (
        "{program} had the CPU: the loop has no real-time priority, so it waits like any program",
        "give the loop SCHED_FIFO (--priority 80, rtprio in /etc/security/limits.d)",
    ),
    "unknown": (
        "another thread had the CPU when the loop was due; which one is not known",
        "run motord latency --suspects as root",
    ),
    "page faults of the loop": (
        "the loop itself took page faults: its memory is not locked, or this process forks",
        "raise memlock in /etc/security/limits.d; start no process by fork in the loop's process",
    ),
    "hypervisor": (
        "the hypervisor gave CPU {cpus} to another machine (steal)",
        "a real-time loop needs a machine that is not shared",
    ),
    "interrupt": (
        "{name} comes far more often on CPU {cpus} when ticks are late",
        "move it to another CPU (/proc/irq/N/smp_affinity)",
    ),
    "timer": (
        "CPU {cpus} had no other work, and yet woke up late: deep sleep, firmware or hypervisor",
        "governor performance, processor.max_cstate=1, or no virtual machine",
    ),
    "tick": (
        "the tick's own work took the time",
        "lower the loop's rate; look at the stage that took longest",
    ),
}
"""Kind of cause → its description, and what the user can do."""
