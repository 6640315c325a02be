# SPDX-License-Identifier: Apache-2.0
"""Rigs are imported by their own names, from any of these folders: in the guest of `make vm`, which
has some of these tests, all are in one."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), *(str(path) for path in HERE.iterdir() if path.is_dir())]
