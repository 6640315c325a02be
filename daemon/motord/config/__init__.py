# SPDX-License-Identifier: Apache-2.0
"""The robot file: `load_robot` reads one, and says every problem at once with its line."""

from motord.config.bus_sections import (
    BusInput,
    BusPublish,
    MqttBroker,
    MqttInput,
    MqttPublish,
    OtherInput,
    OtherPublish,
    PrometheusPublish,
    Publish,
    StdoutPublish,
    TokenInput,
    Topic,
    UdpPublish,
)
from motord.config.line_sections import DdsmLine, RtuLine, RtuOverTcpLine, TcpLine
from motord.config.load import load_robot
from motord.config.model import (
    Base,
    DifferentialBase,
    Joint,
    Limits,
    Loop,
    Odometry,
    Robot,
    RtInput,
    Safety,
    SkidBase,
    SocketInput,
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
    "BusPublish",
    "BusInput",
    "TokenInput",
    "Topic",
    "MqttBroker",
    "MqttPublish",
    "MqttInput",
    "PrometheusPublish",
    "OtherPublish",
    "OtherInput",
    "ConfigError",
    "Problem",
]
