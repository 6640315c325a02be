# SPDX-License-Identifier: Apache-2.0
"""Sentences that explain the figures of a demonstration to a person. Pure."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from typing import Any

from motord.tools.course import Score

OVERRUNS_NORMAL_PERCENT = 2.0
ERRORS_NORMAL_PERCENT = 2.0
HELD_UP_MAX_S = 0.1
"""Longest acceptable wait for a processor. Feedback is fresh for 0.25 s by default, so a longer
wait comes too near to that."""
WAITED_MAX_PART = 0.1
_ERRORS = {
    "no_reply": "no reply in time; the request was sent again",
    "bad_reply": "a reply that was damaged or too late; it was not used",
    "refused": "the drive refused a request",
    "port": "the port was lost and opened again",
}


class Source(enum.StrEnum):
    """What odometry is computed from: the least exact source of all wheels."""

    COUNTERS = "counters"
    SPEEDS = "speeds"
    SETPOINTS = "set-points"


_WORTH = {
    Source.COUNTERS: (
        "every wheel has a position counter: on a floor it is as exact as wheel_radius_m and "
        "track_m are measured, less what the wheels slip"
    ),
    Source.SPEEDS: (
        "an estimate, not judged by a limit: a wheel without a position counter is followed by "
        "the speed that its drive reports, so the error grows with the distance and with every "
        "late reply; add encoders, or correct the pose by a lidar or a camera"
    ),
    Source.SETPOINTS: (
        "an estimate, not judged by a limit: a wheel without a counter and without a measured "
        "speed is taken to follow its set-point; motord does not notice when it lags, slips or "
        "stands; add encoders, or correct the pose by a lidar or a camera"
    ),
}


def worth(source: Source, score: Score) -> str:
    """Return how exact this robot's odometry is; for an estimate, also its error in this run."""
    if source is Source.COUNTERS:
        return _WORTH[source]
    off = (
        f"{1000.0 * score.position_error_m:.0f} mm and {score.heading_error_rad:.3f} rad off after "
        f"{score.distance_m:.1f} m"
    )
    return f"{_WORTH[source]}; in this run it was {off}"


def overrun_words(loop: Mapping[str, Any]) -> str:
    """Return whether the number of skipped ticks is normal; empty: no tick was skipped."""
    if not loop["overruns"]:
        return ""
    if loop["policy"] == "SCHED_OTHER":
        return (
            "ticks are skipped when the loop gets no processor: normal without SCHED_FIFO; on a "
            "robot, allow it as in docs/service.md"
        )
    if 100.0 * loop["overruns"] <= OVERRUNS_NORMAL_PERCENT * loop["ticks"]:
        return (
            "ticks are skipped when the loop wakes late: normal on a computer with other work or a "
            "virtual machine; the loop goes on with the next tick"
        )
    return (
        "many ticks were skipped: this machine keeps the loop from running; end other programs "
        "here; on a robot, `motord latency` shows whether it is fit (docs/latency.md)"
    )


def error_words(line: Mapping[str, Any]) -> Iterator[str]:
    """Yield what each kind of error on a line means, then whether their number is normal here."""
    errors = {kind: count for kind, count in line["errors"].items() if count}
    for kind in errors:
        if kind in _ERRORS:
            yield f"{kind}: {_ERRORS[kind]}"
    if not errors:
        return
    if 100.0 * sum(errors.values()) <= ERRORS_NORMAL_PERCENT * line["exchanges"]:
        yield (
            "so few are normal here, where simulated drives wait for a processor; on a real line "
            "each one has a cause in the wiring (docs/rs485.md)"
        )
    else:
        yield (
            "more than usual: on a busy machine simulated drives answer too late; try again when "
            "it is idle; on a real line look at wiring, baud rate and termination (docs/rs485.md)"
        )


def held_up_words(drives_s: float, program_s: float, daemon_part: float) -> str:
    """Return a warning if the machine was too busy for this measurement; empty: it was not.
    `daemon_part` is the part of its time that the daemon waited for a processor."""
    if max(drives_s, program_s) <= HELD_UP_MAX_S and daemon_part <= WAITED_MAX_PART:
        return ""
    return (
        f"this machine was busy: the simulated drives waited up to {drives_s:.2f} s for a "
        f"processor, the program that drives them up to {program_s:.2f} s, the daemon "
        f"{100.0 * daemon_part:.0f} % of its time; a fault or a wide error then means nothing for "
        "the robot file: try again when the machine is idle"
    )
