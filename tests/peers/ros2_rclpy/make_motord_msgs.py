# SPDX-License-Identifier: Apache-2.0
"""MOTORD_ROS= python -m tests.peers.ros2_rclpy.make_motord_msgs FOLDER

Build motord_msgs, as `motord ros2-msgs` writes it, into an environment of ROS 2 wheels. The wheels
have the generators of rosidl but no ament_cmake: `rosidl generate` writes the sources, and this
program compiles them for the two type supports that rmw_fastrtps_cpp uses: its own, and that for
introspection, with which Jazzy describes a type. With an empty MOTORD_ROS this process
loads no library of the environment that it builds."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.peers.ros2_rclpy.rclpy_real import environ_of, site_of

from motord.tools.ros2_msgs import PACKAGE, write_package

DEADLINE_S = 600.0
GENERATED = ("c", "cpp", "fastrtps_cpp", "fastrtps_c", "introspection_c", "py")
C, PYTHON = "rosidl_generator_c", "rosidl_generator_py"
FASTRTPS, TYPESUPPORT = "rosidl_typesupport_fastrtps", "rosidl_typesupport_c"
INTROSPECTION = "rosidl_typesupport_introspection_c"


class Build:
    def __init__(self, folder, work):
        self.folder, self.work = folder, work
        self.site = site_of(folder)
        self.environ = os.environ | environ_of(folder) | {"AMENT_PREFIX_PATH": str(folder)}

    def generate(self):
        """Generate the sources, in one folder and one root of includes for each generator."""
        package = write_package(self.work)
        written = [*package.glob("msg/*.msg"), *package.glob("action/*.action")]
        names = [f"{path.parent.name}/{path.stem}" for path in written]
        hashes = self.work / "hashes"
        self._rosidl(
            "hash", hashes, *(f"{package}:{path.relative_to(package)}" for path in written)
        )
        described = [each for name in names for each in ("-td", f"{hashes}/{name}.json")]
        interfaces = [f"{hashes}/tmp:{name}.idl" for name in names]
        self._rosidl("generate", self.work / "made", *interfaces, options=described)
        for kind in GENERATED:
            root = self.work / "include" / kind
            root.mkdir(parents=True)
            (root / PACKAGE).symlink_to(self.work / "made" / kind)

    def _rosidl(self, command, to, *files, options=()):
        subprocess.run(
            [self.folder / "bin/rosidl", command, "-o", to, "-I", self.folder / "share", *options,
             PACKAGE, *files],
            env=self.environ, cwd=self.work, check=True, timeout=DEADLINE_S,
            stdout=subprocess.DEVNULL,
        )  # fmt: skip

    def sources(self, kind, pattern):
        return sorted((self.work / "made" / kind).rglob(pattern))

    def library(self, name, sources, *needs):
        """Build lib/libPACKAGE__NAME.so. `needs`: libraries of the package that it links with."""
        file = self.folder / "lib" / f"lib{PACKAGE}__{name}.so"
        self.link(file, sources, *needs)

    def link(self, file, sources, *needs):
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            objects = list(pool.map(self._compiled, sources))
        libraries = [path for path in self.folder.glob("lib/*.so") if PACKAGE not in path.name]
        libraries += [self.folder / f"lib/lib{PACKAGE}__{need}.so" for need in needs]
        named = ["-Wl,--as-needed", f"-Wl,-soname,{file.name}"]
        self._run("g++", "-shared", "-o", file, *objects, *named, *libraries)

    def _compiled(self, source):
        language = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc"]
        made = source.with_name(f"{source.name}.o")
        roots = [self.folder / "include", *(self.folder / "include").iterdir(),
                 *(self.work / "include").iterdir(), sysconfig.get_path("include"),
                 *self.site.glob("numpy/*/include")]  # fmt: skip
        including = [f"-I{root}" for root in roots]
        self._run(*language, "-O0", "-fPIC", "-w", *including, "-c", source, "-o", made)
        return made

    def _run(self, *command):
        subprocess.run(command, cwd=self.work, check=True, timeout=DEADLINE_S)

    def install(self):
        """Install the libraries, the Python package with extension module, and the hashes."""
        self.library(C, self.sources("c", "*.c"))
        self.library(f"{FASTRTPS}_cpp", self.sources("fastrtps_cpp", "*.cpp"), C)
        self.library(f"{FASTRTPS}_c", self.sources("fastrtps_c", "*.cpp"), C, f"{FASTRTPS}_cpp")
        self.library(INTROSPECTION, self.sources("introspection_c", "*.c"), C)
        self.library(TYPESUPPORT, self.sources("c", "*.cpp"), C, f"{FASTRTPS}_c")
        self.library(PYTHON, self.sources("py", "_*_s.c"), C, TYPESUPPORT)
        made = self.work / "made/py"
        entry = made / f"_{PACKAGE}_s.ep.{TYPESUPPORT}.c"
        module = f"{PACKAGE}_s__{TYPESUPPORT}{sysconfig.get_config_var('EXT_SUFFIX')}"
        package = self.site / PACKAGE
        shutil.rmtree(package, ignore_errors=True)
        shutil.copytree(made, package, ignore=shutil.ignore_patterns("*.c", "*.o"))
        (package / "__init__.py").touch()
        self.link(package / module, [entry], C, TYPESUPPORT, PYTHON)
        shutil.copytree(
            self.work / "hashes", self.folder / "share" / PACKAGE, dirs_exist_ok=True,
            ignore=shutil.ignore_patterns("tmp"),
        )  # fmt: skip


def main(folder):
    with tempfile.TemporaryDirectory() as work:
        build = Build(Path(folder).resolve(), Path(work))
        build.generate()
        build.install()


if __name__ == "__main__":
    main(sys.argv[1])
