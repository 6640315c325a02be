# SPDX-License-Identifier: Apache-2.0
"""Drive for some seconds by datagrams: send_command.py LOCAL_SOCKET V_M_S W_RAD_S SECONDS"""

import json
import socket
import struct
import sys
import time
from typing import Any, TextIO


def call(link: TextIO, method: str, params: dict[str, Any]) -> Any:
    link.write(json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}) + "\n")
    link.flush()
    answer = json.loads(link.readline())
    if "error" in answer:
        raise SystemExit(answer["error"]["message"])
    return answer["result"]


def main(path: str, linear_m_s: float, angular_rad_s: float, seconds: float) -> None:
    with (
        socket.socket(socket.AF_UNIX) as local,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as commands,
    ):
        local.connect(path)
        lease = call(local.makefile("rw"), "lease", {"owner": "example"})
        commands.connect(lease["socket"])
        token, end_s = bytes.fromhex(lease["token"]), time.monotonic() + seconds
        sequence = 0
        while time.monotonic() < end_s:
            sequence += 1
            stamp_ns = time.monotonic_ns()
            head = (0x434D544D, 1, 1, token, sequence, stamp_ns, 0, 0)
            commands.send(struct.pack("<IHH16sQqIIdd", *head, linear_m_s, angular_rad_s))
            time.sleep(0.02)
    print(f"{sequence} commands")


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
