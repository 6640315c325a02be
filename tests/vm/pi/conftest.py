# SPDX-License-Identifier: Apache-2.0
"""Tests of the pins of a Raspberry Pi. They run only in the emulated one that `make vm` starts."""

import os

collect_ignore_glob = [] if os.environ.get("MOTORD_VM") == "1" else ["*"]
