# SPDX-License-Identifier: Apache-2.0
"""A Zenoh router and another node in one process: prints the stamp of each odometry message, and
sends a command for each line of its input, a speed in m/s.

python -m tests.peers.ros2_zenoh.zenoh_far HOST:PORT FOLDER: by TLS, with host.pem and
host.key in that folder.
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
