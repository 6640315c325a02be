# SPDX-License-Identifier: Apache-2.0
"""Writes `motord_msgs`, the ROS 2 package of motord's own types, for colcon. Sources: REP-149
(package.xml), and the use of rosidl_generate_interfaces in ROS 2's tutorial on custom interfaces.
"""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path

from motord.bus.messages.table import TYPES, action_definition, message_definition

PACKAGE = "motord_msgs"
_ACTIONS_NEED = "action_msgs"
_PARTS = ("_Goal", "_Result", "_Feedback")
_MANIFEST = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>Messages and actions of motord, written by motord ros2-msgs</description>
  <maintainer email="nobody@motord.invalid">motord</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depends}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""
_BUILD = """\
cmake_minimum_required(VERSION 3.8)
project({package})

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{finds}

rosidl_generate_interfaces(${{PROJECT_NAME}}
{files}
  DEPENDENCIES {needs}
)

ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def package_files() -> dict[str, str]:
    """Return the files of the package: path below its folder → text."""
    files, used = {}, {_ACTIONS_NEED}
    for name in sorted(TYPES):
        package, folder, word = name.split("/")
        action = word.removesuffix("_Goal")
        if package != PACKAGE or not (folder == "msg" or word.endswith(_PARTS)):
            continue
        used |= {field.kind.partition("/")[0] for field in TYPES[name] if not field.primitive}
        if folder == "msg":
            files[f"msg/{word}.msg"] = message_definition(name)
        elif action != word:
            files[f"action/{action}.action"] = action_definition(f"{PACKAGE}/action/{action}")
    needs = sorted(used - {PACKAGE})
    build = _BUILD.format(
        package=PACKAGE,
        finds="\n".join(f"find_package({need} REQUIRED)" for need in needs),
        files="\n".join(f'  "{name}"' for name in files),
        needs=" ".join(needs),
    )
    depends = "\n".join(f"  <depend>{need}</depend>" for need in needs)
    manifest = _MANIFEST.format(package=PACKAGE, version=_version(), depends=depends)
    return {"package.xml": manifest, "CMakeLists.txt": build, **files}


def write_package(folder: Path) -> Path:
    """Write the package to a new folder with its name, and return that folder. Raise
    FileExistsError if the folder exists, or another OSError."""
    package = folder / PACKAGE
    package.mkdir(parents=True)
    for name, text in package_files().items():
        path = package / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return package


def _version() -> str:
    """Return motord's version as three numbers, which is all that REP-149 allows; 0.0.0 if motord
    is not installed."""
    try:
        found = re.match(r"\d+\.\d+\.\d+", metadata.version("motord"))
    except metadata.PackageNotFoundError:
        found = None
    return found[0] if found else "0.0.0"
