# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.speed_loop]: how the core holds the speed of a wheel whose drive does not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from motord.config.sections.section import Number, Section, number, numbers_of

CoreGain = Literal[
    "gain_u_s_per_rad",
    "integral_u_per_rad",
    "derivative_u_s2_per_rad",
    "static_u",
    "viscous_u_s_per_rad",
    "acceleration_u_s2_per_rad",
]
"""Fields of `speed_loop_gains` of the core."""
TORQUE_GAINS: Mapping[str, CoreGain] = {
    "gain_n_m_s_per_rad": "gain_u_s_per_rad",
    "integral_n_m_per_rad": "integral_u_per_rad",
    "derivative_n_m_s2_per_rad": "derivative_u_s2_per_rad",
    "static_n_m": "static_u",
    "viscous_n_m_s_per_rad": "viscous_u_s_per_rad",
    "inertia_kg_m2": "acceleration_u_s2_per_rad",
}
"""Keys for a drive that takes a torque, with their fields in `speed_loop_gains` of the core."""
DUTY_GAINS: Mapping[str, CoreGain] = {
    "gain_s_per_rad": "gain_u_s_per_rad",
    "integral_per_rad": "integral_u_per_rad",
    "derivative_s2_per_rad": "derivative_u_s2_per_rad",
    "acceleration_s2_per_rad": "acceleration_u_s2_per_rad",
}
"""Keys for a drive that takes a duty. Static and viscous feed-forward are the joint's open-loop
map: duty_dead_band and full_duty_rad_s."""
TORQUE_KEYS = frozenset((*TORQUE_GAINS, "torque_max_n_m"))
DUTY_KEYS = frozenset((*DUTY_GAINS, "correction_max"))


class SpeedLoop(Section):
    """PID with feed-forward, at the wheel, in every tick of the loop. Keys with N·m and kg·m² are
    for a drive that takes a torque, those with duty for one that takes a duty."""

    gain_n_m_s_per_rad: float = number(
        "torque for a speed that is 1 rad/s off", 0, 1e6, "N·m·s/rad", 0.0
    )
    integral_n_m_per_rad: float = number(
        "torque for the angle that it has lost", 0, 1e6, "N·m/rad", 0.0
    )
    derivative_n_m_s2_per_rad: float = number(
        "torque against the measured acceleration", 0, 1e6, "N·m·s²/rad", 0.0
    )
    static_n_m: float = number("feed-forward: torque of the static friction", 0, 1e6, "N·m", 0.0)
    viscous_n_m_s_per_rad: float = number(
        "feed-forward: torque for each rad/s of the set-point", 0, 1e6, "N·m·s/rad", 0.0
    )
    inertia_kg_m2: float = number(
        "feed-forward: torque for each rad/s² by which the set-point rises", 0, 1e6, "kg·m²", 0.0
    )
    torque_max_n_m: float | None = number(
        "torque at most; a drive that takes a torque needs it", 0.001, 1e6, "N·m", None
    )
    gain_s_per_rad: float = number("duty for a speed that is 1 rad/s off", 0, 1e3, "s/rad", 0.0)
    integral_per_rad: float = number("duty for the angle that it has lost", 0, 1e4, "1/rad", 0.0)
    derivative_s2_per_rad: float = number(
        "duty against the measured acceleration", 0, 1e3, "s²/rad", 0.0
    )
    acceleration_s2_per_rad: float = number(
        "feed-forward: duty for each rad/s² by which the set-point rises; duty_dead_band and "
        "full_duty_rad_s of the joint are the rest of it",
        0,
        1e3,
        "s²/rad",
        0.0,
    )
    correction_max: float = number(
        "how far the loop may take the duty from its feed-forward: what a broken encoder can add",
        0.01,
        1,
        "1",
        0.3,
    )
    filter_s: float = number(
        "time constant of the measured speed that the derivative is taken of", 0, 10, "s", 0.05
    )


GAIN_NUMBERS: Mapping[str, Number] = {
    key: one
    for key, one in numbers_of(SpeedLoop).items()
    if key in TORQUE_GAINS or key in DUTY_GAINS
}
"""Numbers that may be changed while the daemon runs."""
