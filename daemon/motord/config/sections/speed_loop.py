# SPDX-License-Identifier: Apache-2.0
"""[joint.NAME.speed_loop]: how the core holds the speed of a wheel whose drive takes a torque."""

from __future__ import annotations

from motord.config.sections.section import Section, number


class SpeedLoop(Section):
    """PI, at the wheel, in every tick of the loop."""

    gain_n_m_s_per_rad: float = number(
        "torque for a speed that is 1 rad/s off", 0, 1e6, "N·m·s/rad"
    )
    integral_n_m_per_rad: float = number("torque for the angle that it has lost", 0, 1e6, "N·m/rad")
    torque_max_n_m: float = number("torque at most", 0.001, 1e6, "N·m")
