# SPDX-License-Identifier: Apache-2.0
"""The robot file: `load_robot` reads one, and says every problem at once with its line."""

from motord.config.line_sections import DdsmLine, RtuLine, RtuOverTcpLine, TcpLine
from motord.config.load import load_robot
from motord.config.model import (
    Base,
    DifferentialBase,
    Joint,
    Limits,
    Loop,
    Odometry,
    Publish,
    Robot,
    RtInput,
    Safety,
    SkidBase,
    SocketInput,
    StdoutPublish,
    UdpPublish,
)
from motord.config.problems import ConfigError, Problem

__all__ = [
    "load_robot",
    "Robot",
    "Loop",
    "Base",
    "DifferentialBase",
    "SkidBase",
    "Limits",
    "Safety",
    "Odometry",
    "RtuLine",
    "DdsmLine",
    "TcpLine",
    "RtuOverTcpLine",
    "Joint",
    "SocketInput",
    "RtInput",
    "Publish",
    "StdoutPublish",
    "UdpPublish",
    "ConfigError",
    "Problem",
]
