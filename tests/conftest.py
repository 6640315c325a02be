# SPDX-License-Identifier: Apache-2.0
"""What every test folder shares. `MOTORD_RT_DIR` puts another build of the C core first (make
san)."""

import os
import sys

if directory := os.environ.get("MOTORD_RT_DIR"):
    sys.path.insert(0, os.path.abspath(directory))
