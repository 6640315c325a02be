# SPDX-License-Identifier: Apache-2.0
"""Tests of a Raspberry Pi's own pins: only there, where `make vm` says that it is for that."""

import os

collect_ignore_glob = [] if os.environ.get("MOTORD_VM") == "1" else ["*"]
