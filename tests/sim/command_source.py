# SPDX-License-Identifier: Apache-2.0
"""A program that sends commands as datagrams, and the robot's setting for them."""

import socket

from motord.api.commands import datagram
from motord_hal.realtime.exchange import now_ns

INPUTS = """
[input.autopilot]
kind = "rt"
priority = 50
lease_s = 2.0
udp_port = {port}
"""


def free_udp_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Source:
    """A program that has a lease, and sends commands as datagrams."""

    def __init__(self, stage, **params):
        self.robot = stage.client()
        self.lease = self.robot.call("lease", **params)
        self.to = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.to.connect(self.lease["socket"])
        self.sequence = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.to.close()
        self.robot.close()

    def send(self, linear_m_s, angular_rad_s=0.0, **changes):
        self.sequence += 1
        command = {"token": bytes.fromhex(self.lease["token"]), "sequence": self.sequence,
                   "stamp_ns": now_ns(), "linear_m_s": linear_m_s,
                   "angular_rad_s": angular_rad_s} | changes  # fmt: skip
        self.to.send(datagram(**command))


def wheels_turn(stage):
    return all(abs(j["velocity_rad_s"]) > 1.0 for j in stage.sim.call("truth")["joints"].values())
