# SPDX-License-Identifier: Apache-2.0
"""What is logged of endpoints of others on our topics whose type is another one: no middleware
brings them together, and most say nothing of it."""

from __future__ import annotations

from typing import Literal

from motord.bus.ros2.names import dds_type

CURES = {
    ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"): "stamped = false takes Twist",
    ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"): "stamped = true takes it",
}
"""By what we want and what there is: what to write into the robot file."""
Side = Literal["writer", "reader"]


def type_conflict(topic: str, side: Side, ours: str, theirs: str) -> str | None:
    """`ours` is a type of `table.TYPES`, `theirs` a name as the middleware has it. None: it is the
    same one."""
    if theirs == dds_type(ours):
        return None
    kind = theirs.replace("::dds_::", "::").removesuffix("_").replace("::", "/")
    lost = (
        "is not received: motord expects" if side == "writer" else "receives nothing: motord writes"
    )
    cure = CURES.get((ours, kind))
    return f"{topic}: a {side} of {kind} {lost} {ours}" + (f" ({cure})" if cure else "")
