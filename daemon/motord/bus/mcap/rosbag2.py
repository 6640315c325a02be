# SPDX-License-Identifier: Apache-2.0
"""What rosbag2 keeps beside the messages of an MCAP file, so that `ros2 bag play` offers a topic as
its publisher did: what was latched is latched again.

Policies are numbers, as in version 8 of rosbag2's metadata: Humble reads no other version, and
later releases read it if a record names it (rosbag2_storage, qos.cpp; rosbag2_storage_mcap,
mcap_storage.cpp). YAML is written as JSON, which it contains.
"""

from __future__ import annotations

import json

from motord.bus.messages.table import type_hash
from motord.bus.ros2.quality import offered

RECORD = "rosbag2"
"""Name of the record that holds `METADATA`."""
_VERSION = 8
_KEEP_LAST, _RELIABLE, _BEST_EFFORT, _TRANSIENT_LOCAL, _VOLATILE, _AUTOMATIC = 1, 1, 2, 1, 2, 1
"""Numbers of rmw/types.h."""
_INFINITE = {"sec": 9223372036, "nsec": 854775807}
"""RMW_DURATION_INFINITE of rmw/types.h."""
_COUNTED = {
    "version": _VERSION,
    "storage_identifier": "mcap",
    "duration": {"nanoseconds": 0},
    "starting_time": {"nanoseconds_since_epoch": 0},
    "message_count": 0,
    "topics_with_message_count": [],
    "compression_format": "",
    "compression_mode": "",
    "relative_file_paths": [],
    "files": [],
    "custom_data": {},
    "ros_distro": "",
}
METADATA = {"serialized_metadata": json.dumps(_COUNTED)}
"""Content of the record. Its counts are zero: readers take them from the file's index."""


def channel_metadata(topic: str, type_name: str) -> dict[str, str]:
    """Return the metadata of a channel."""
    quality = offered(topic)
    profile = {
        "history": _KEEP_LAST,
        "depth": quality.depth,
        "reliability": _RELIABLE if quality.reliable else _BEST_EFFORT,
        "durability": _TRANSIENT_LOCAL if quality.latched else _VOLATILE,
        "deadline": _INFINITE,
        "lifespan": _INFINITE,
        "liveliness": _AUTOMATIC,
        "liveliness_lease_duration": _INFINITE,
        "avoid_ros_namespace_conventions": False,
    }
    return {
        "offered_qos_profiles": json.dumps([profile]),
        "topic_type_hash": type_hash(type_name),
    }
