# SPDX-License-Identifier: Apache-2.0
"""What pyproject.toml cannot say: the cffi extensions, and config/ as data of the wheel."""

import os
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py


class BuildWithConfig(build_py):
    """Copies config/ to motord_hal/_config in a wheel; a checkout reads its own config/."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib, "motord_hal", "_config")
            shutil.copytree("config", target, dirs_exist_ok=True)


class BuildOnce(build_ext):
    """Nothing where MOTORD_COMPILED is set: the Makefile compiles csrc by itself, once for all that
    it installs."""

    def run(self) -> None:
        if not os.environ.get("MOTORD_COMPILED"):
            super().run()


setup(
    cffi_modules=["csrc/build_ffi.py:ffi", "csrc/build_bus.py:ffi"],
    cmdclass={"build_ext": BuildOnce, "build_py": BuildWithConfig},
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
