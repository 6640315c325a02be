# SPDX-License-Identifier: Apache-2.0
"""A Zenoh router and a ROS 2 node in one process. It prints the stamp of each odometry message. For
each line of its standard input, a speed in m/s, it sends a command.

python -m tests.peers.ros2_zenoh.zenoh_far HOST:PORT FOLDER: listens there by TLS, with host.pem
and host.key in FOLDER.
"""

import json
import struct
import sys

import zenoh
from tests.peers.ros2_zenoh.zenoh_rig import attached
from tests.peers.ros2_zenoh.zenoh_robot_rig import COMMAND_KEY, command

_, _, KIND = COMMAND_KEY.partition("/cmd_vel/")


def sent(sample):
    sec, nanosec = struct.unpack_from("<iI", sample.payload.to_bytes(), 4)
    print(f"{sec}.{nanosec:09d}", flush=True)


def main():
    address, folder = sys.argv[1:]
    own = {
        "listen_certificate": f"{folder}/host.pem",
        "listen_private_key": f"{folder}/host.key",
    }
    config = {
        "mode": "router",
        "listen": {"endpoints": [f"tls/{address}"]},
        "transport": {"link": {"tls": own}},
        "scouting": {"multicast": {"enabled": False}},
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        kept = session.declare_subscriber("0/zenoh/odom/**", sent)
        for number, line in enumerate(sys.stdin, 1):
            key = f"0/zenoh/cmd_vel/{KIND}"
            session.put(key, command(float(line)), attachment=attached(number))
        kept.undeclare()


if __name__ == "__main__":
    main()
