# SPDX-License-Identifier: Apache-2.0
"""[safety.feedback]: when a wheel's feedback, or what its drive does, is not believed any more."""

from __future__ import annotations

from motord.config.sections.section import Section, number


class FeedbackChecks(Section):
    """Each check latches a fault when it holds for its time; a time of 0 switches it off. Parts are
    those of the joint's working speed: the fastest that [limits] request of it, at most its own."""

    direction_s: float = number(
        "a wheel that turns against its set-point for this long is a fault; 0: no check",
        0,
        60,
        "s",
        0.5,
    )
    stall_s: float = number(
        "a wheel that does not turn for this long is a fault; 0: no check", 0, 60, "s", 1.0
    )
    setpoint_min_part: float = number(
        "direction and stall are judged from this set-point on", 0.01, 1, "1", 0.1
    )
    following_s: float = number(
        "a wheel that lacks following_part for this long and comes no nearer to its set-point is a "
        "fault; 0: no check, as for a drive that takes a duty where it is not given",
        0,
        60,
        "s",
        1.0,
    )
    following_part: float = number(
        "how much slower than its set-point a wheel may be", 0.01, 10, "1", 0.4
    )
    position_following_s: float = number(
        "a joint that takes positions and is farther than position_following_rad from its "
        "set-point for this long, and comes no nearer, is a fault; 0: no check",
        0,
        60,
        "s",
        1.0,
    )
    position_following_rad: float = number(
        "how far from its set-point a joint that takes positions may be, beside what its set-point "
        "moves in 0.25 s",
        0.001,
        10,
        "rad",
        0.15,
    )
    runaway_s: float = number(
        "a wheel that is faster by runaway_part for this long and comes no nearer to its set-point "
        "is a fault; 0: no check",
        0,
        60,
        "s",
        0.5,
    )
    runaway_part: float = number(
        "how much faster than its set-point a wheel may be; 1 for a drive that takes a duty where "
        "it is not given",
        0.01,
        10,
        "1",
        0.4,
    )
    implausible_s: float = number(
        "a counter and a reported velocity that contradict each other for this long are a fault; "
        "0: no check",
        0,
        60,
        "s",
        1.0,
    )
    jumps_max: int = number(
        "this many counter jumps within a second are a fault; 0: any number", 0, 1000, "1", 3
    )
