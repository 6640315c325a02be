# SPDX-License-Identifier: Apache-2.0
"""The second process has no devices: none of its modules loads the C core or a line."""

import json
import subprocess
import sys

PROGRAM = """
import importlib, json, pkgutil, sys
import motord.bus

loaded = []
for module in pkgutil.walk_packages(motord.bus.__path__, "motord.bus."):
    if module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:  # an extra that is not installed
        if error.name.startswith("motord"):
            raise
    loaded.append(module.name)
ours = [name for name in sys.modules if name.startswith(("_motord", "motord_hal"))]
print(json.dumps([loaded, ours]))
"""
VALUES = (
    "motord_hal.base",
    "motord_hal.drives",
    "motord_hal.fieldbus.ports",
    "motord_hal.fieldbus.trace",
)


def test_no_module_of_the_second_process_loads_a_device_or_the_core():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=120
    )
    loaded, ours = json.loads(done.stdout)
    assert "motord.bus.process" in loaded
    allowed = {"motord_hal", "motord_hal.fieldbus", "_motord_bus"}
    others = [name for name in ours if name not in allowed and not name.startswith(VALUES)]
    assert others == []
