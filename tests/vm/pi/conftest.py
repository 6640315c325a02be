# SPDX-License-Identifier: Apache-2.0
"""Tests of a Raspberry Pi's own pins: only in the machine that `make vm` starts for them."""

import os

collect_ignore_glob = [] if os.environ.get("MOTORD_VM") == "1" else ["*"]
