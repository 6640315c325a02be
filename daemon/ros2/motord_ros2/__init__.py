# SPDX-License-Identifier: Apache-2.0
"""The bridge node, with its own copy of the parts of motord that it needs."""

from __future__ import annotations

import sys
from pathlib import Path


def main() -> int:
    """Returns the exit status."""
    sys.path.insert(0, str(Path(__file__).resolve().parent / "_lib"))
    from motord.ros2_rclpy.__main__ import main as bridge

    return bridge()
