# SPDX-License-Identifier: Apache-2.0
"""The results of `motord latency` as numbers: spreads, the latency class, JSON. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from motord.tools.latency.causes.suspects import Verdict
    from motord.tools.latency.trials import Trial

FRACTIONS = {"p50": 0.5, "p99": 0.99, "p99_9": 0.999}
FIGURES = (*FRACTIONS, "max")
DECIMALS = 3


def rank(fraction: float, samples: int) -> int:
    """Return the nearest rank, from 0, of a percentile: the rank of the smallest value that the
    part `fraction` of all samples does not exceed."""
    return max(math.ceil(fraction * samples), 1) - 1


def value_at(counts: Mapping[int, int], wanted: int, beyond: float) -> float:
    """Return the value at a rank, from 0, in value → count; `beyond` if there are fewer counts."""
    seen = 0
    for value, count in sorted(counts.items()):
        seen += count
        if seen > wanted:
            return float(value)
    return beyond


def number(value: float) -> float | None:
    """Round a number for JSON; return None for NaN or infinity (nothing measured, no limit)."""
    return round(value, DECIMALS) if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Spread:
    """Percentiles of one figure, in the unit of its key in the report; NaN without a sample."""

    samples: int
    p50: float
    p99: float
    p99_9: float
    max: float

    @classmethod
    def of_counts(cls, counts: Mapping[int, int], samples: int, maximum: float) -> Spread:
        """Make it from value → count. `samples` may exceed the sum of the counts: the other samples
        are greater than all these values, up to `maximum`. No percentile is above `maximum`."""
        if samples == 0:
            return NOTHING
        p50, p99, p99_9 = (
            min(value_at(counts, rank(fraction, samples), maximum), maximum)
            for fraction in FRACTIONS.values()
        )
        return cls(samples, p50, p99, p99_9, maximum)

    def scaled(self, factor: float) -> Spread:
        """Return the spread with all figures multiplied by a factor, to change the unit."""
        figures = (getattr(self, name) * factor for name in FIGURES)
        return Spread(self.samples, *figures)

    def to_json(self) -> dict[str, float | int | None]:
        return {"samples": self.samples, **{name: number(getattr(self, name)) for name in FIGURES}}


NOTHING = Spread(0, math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Bar:
    """The number of ticks that were between `low_us` and `high_us` late."""

    low_us: float
    high_us: float
    count: int


@dataclass(frozen=True, slots=True)
class Window:
    """All ticks between two looks at the loop's histogram."""

    start_s: float
    end_s: float
    ticks: int
    lateness_max_us: float
    """Upper edge of the highest bucket that grew; it is at most 6.25 % above the true maximum."""
    overruns: int


@dataclass(frozen=True, slots=True)
class LatencyClass:
    name: str
    limit_us: float
    meaning: str

    def to_json(self) -> dict[str, str | float | None]:
        return {"name": self.name, "limit_us": number(self.limit_us), "meaning": self.meaning}

    def __str__(self) -> str:
        bound = f"≤ {self.limit_us:.0f} µs" if math.isfinite(self.limit_us) else "> 500 µs"
        return f"{self.name} ({bound})"


# Source of the limits: LinuxCNC, docs/src/install/latency-test.adoc, for the worst jitter of a run.
CLASSES = (
    LatencyClass("good", 20.0, "even steps made in software keep their time"),
    LatencyClass("usable", 50.0, "loops of several kHz keep their time; software steps run slower"),
    LatencyClass(
        "hardware stepping only",
        500.0,
        "no steps in software; drives that regulate themselves, on Modbus or CAN, do well at 1 kHz",
    ),
    LatencyClass(
        "unusable",
        math.inf,
        "the processor was away for half a millisecond or more: find out why before you trust "
        "the robot's timing; drives with a watchdog of their own still stop in time",
    ),
)


def latency_class(lateness_max_us: float) -> LatencyClass:
    """Return LinuxCNC's class of a machine by the lateness of its worst tick. A value on a limit
    belongs to the better class; NaN gives the worst class."""
    return next((c for c in CLASSES if lateness_max_us <= c.limit_us), CLASSES[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyReport:
    """The results of one run."""

    rate_hz: float
    seconds: float
    """Measured duration, which may differ from the requested one."""
    ended_early: bool
    policy: str
    priority: int
    cpu: tuple[int, ...]
    load: str
    ticks: int
    overruns: int
    page_faults: int
    lateness_us: Spread
    step_ns: Spread
    handover_us: dict[str, Spread]
    """Keys: `command_to_core`, `core_to_asyncio`, `command_to_byte`."""
    commands_sent: int
    cyclictest_us: Spread | None
    cyclictest_note: str
    """The command line of cyclictest, or the reason why there is no result."""
    refusals: dict[str, str]
    """What the kernel refused: subject → sentence."""
    machine: dict[str, Any]
    steal_percent: float
    """Part of the processor time that a hypervisor gave to other machines during the run."""
    histogram: Sequence[Bar] = field(repr=False, default=())
    cyclictest_histogram: Sequence[Bar] = field(repr=False, default=())
    timeline: Sequence[Window] = field(repr=False, default=())
    verdict: Verdict | None = None
    """What made ticks late; None: the run did not search for it."""
    trials: Sequence[Trial] = ()
    """Repetitions of the measurement, each with one thing changed; the first is the original."""

    @property
    def latency_class(self) -> LatencyClass:
        return latency_class(self.lateness_us.max)

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object of `motord latency --json`."""
        searched = {}
        if self.verdict is not None:
            searched = self.verdict.to_json() | {"trials": [one.to_json() for one in self.trials]}
        return {
            "rate_hz": self.rate_hz,
            "seconds": number(self.seconds),
            "ended_early": self.ended_early,
            "policy": self.policy,
            "priority": self.priority,
            "cpu": list(self.cpu),
            "load": self.load,
            "class": self.latency_class.to_json(),
            "ticks": self.ticks,
            "overruns": self.overruns,
            "page_faults": self.page_faults,
            "lateness_us": self.lateness_us.to_json(),
            "step_ns": self.step_ns.to_json(),
            "handover_us": {name: s.to_json() for name, s in self.handover_us.items()},
            "commands_sent": self.commands_sent,
            "cyclictest_us": self.cyclictest_us.to_json() if self.cyclictest_us else None,
            "cyclictest_note": self.cyclictest_note,
            "refusals": self.refusals,
            "steal_percent": number(self.steal_percent),
            "machine": self.machine,
            **({"late": searched} if searched else {}),
        }
