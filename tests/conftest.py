# SPDX-License-Identifier: Apache-2.0
"""What every test folder shares. `MOTORD_RT_DIR` puts another build of the C core first (make
san). Property tests have no deadline: a busy machine is no bug."""

import os
import sys

from hypothesis import settings

settings.register_profile("motord", deadline=None)
settings.load_profile("motord")

if directory := os.environ.get("MOTORD_RT_DIR"):
    sys.path.insert(0, os.path.abspath(directory))
