# SPDX-License-Identifier: Apache-2.0
"""Tests against a real kernel's drivers. They change devices, users and packages of the machine
that they run on: only in the guest of `make vm`, or where MOTORD_VM=1 says that it is for that."""

import os
import sys
from pathlib import Path

collect_ignore_glob = [] if os.environ.get("MOTORD_VM") == "1" else ["*"]

PACKAGES = [str(path) for path in Path("/usr/lib/motord/lib").glob("python3.*/site-packages")]
sys.path[:0] = PACKAGES
os.environ["PYTHONPATH"] = os.pathsep.join(PACKAGES)  # for the processes that tests start
