# SPDX-License-Identifier: Apache-2.0
"""Log lines about endpoints of other nodes on our topics whose type differs from ours: no
middleware connects the two, and most report nothing."""

from __future__ import annotations

from typing import Literal

from motord.bus.ros2.names import dds_type

CURES = {
    ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"): "stamped = false takes Twist",
    ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"): "stamped = true takes it",
}
"""Settings of the robot file that remove a conflict, by motord's type and the other node's type."""
Side = Literal["writer", "reader"]


def type_conflict(topic: str, side: Side, ours: str, theirs: str) -> str | None:
    """Return the log line about an endpoint whose type differs; None if the types are the same.
    `ours`: a type of `table.TYPES`; `theirs`: a name as the middleware writes it."""
    if theirs == dds_type(ours):
        return None
    kind = theirs.replace("::dds_::", "::").removesuffix("_").replace("::", "/")
    lost = (
        "is not received: motord expects" if side == "writer" else "receives nothing: motord writes"
    )
    cure = CURES.get((ours, kind))
    return f"{topic}: a {side} of {kind} {lost} {ours}" + (f" ({cure})" if cure else "")
