# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 package of the bridge node: built by colcon and by pip, and found by ROS 2's index. It
needs only the standard library and rclpy, or the stand-in of it."""

import ast
import os
import shutil
import subprocess
import sys
import tomllib
import venv
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from tests.peers.ros2_rclpy.rclpy_real import FOLDER, REAL, site_of
from tests.peers.ros2_rclpy.rclpy_stage import SETTINGS, STANDIN, bridge, operator, ros
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until

PACKAGE = "motord_ros2"
SOURCE = ROOT / "daemon/ros2"
LAYOUT = (
    f"share/ament_index/resource_index/packages/{PACKAGE}",
    f"share/{PACKAGE}/package.xml",
    f"share/{PACKAGE}/launch/bridge.launch.py",
    f"share/{PACKAGE}/config/bridge.yaml",
)
FIND = f"""
from ament_index_python.packages import get_package_prefix, get_package_share_directory
print(get_package_prefix("{PACKAGE}"), get_package_share_directory("{PACKAGE}"))
"""


def run(*words, **options):
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=4 * DEADLINE_S, stdin=subprocess.DEVNULL,
        **options,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def by_pip(tmp_path_factory):
    """The Python program of a virtual environment in which only that package is installed."""
    folder = tmp_path_factory.mktemp("pip")
    source = shutil.copytree(SOURCE, folder / "source", symlinks=False)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    run(*pip, "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", folder, source)
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv/bin/python"
    (wheel,) = folder.glob("*.whl")
    run(*pip, "--python", python, "install", "-q", "--no-deps", "--no-index", wheel)
    return python


def program(prefix):
    """Return the program that `ros2 run` starts."""
    found = prefix / f"lib/{PACKAGE}/bridge"
    assert os.access(found, os.X_OK)
    return found


def no_ros_environ(**more):
    return {
        key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")
    } | more


def test_pip_installs_the_whole_package_and_nothing_else(by_pip):
    prefix = by_pip.parent.parent
    for name in LAYOUT:
        assert (prefix / name).is_file(), name
    done = subprocess.run(
        [by_pip, "-I", program(prefix), "--help"], capture_output=True, timeout=DEADLINE_S
    )
    assert done.returncode == 0, done.stderr
    assert b"--unstamped" in done.stdout
    packages = run(by_pip, "-c", "import importlib.metadata as m; "
                   "print(*(found.name for found in m.distributions()))")  # fmt: skip
    assert packages.split() == [PACKAGE]


def test_the_package_installed_by_pip_serves_a_robot(by_pip, tmp_path):
    """The installed program runs in its own Python, without the rest of motord."""
    if REAL and FOLDER is None:
        pytest.skip("ROS 2's own Python is another")
    rclpy = tmp_path / "standin"
    if FOLDER is None:
        shutil.copytree(STANDIN, rclpy)
    else:
        rclpy = site_of(FOLDER)
    prefix = by_pip.parent.parent
    (library,) = prefix.glob(f"lib/python3*/site-packages/{PACKAGE}/_lib")
    with (
        ros(tmp_path),
        running(tmp_path, *SETTINGS) as stage,
        bridge(
            tmp_path, "--socket", stage.socket, python=by_pip, program=(program(prefix),),
            environ={"PYTHONPATH": f"{rclpy}:{library}"},
        ) as made,
        operator() as person,
    ):  # fmt: skip
        stage.wait_for("idle")
        from std_srvs.srv import Trigger

        def arms():
            return person.call("motord/arm", Trigger).success

        wait_until(arms, f"armed\n{made.logged()}")
        assert stage.state() == "armed"


@pytest.mark.skipif(shutil.which("colcon") is None, reason="needs colcon")
@pytest.mark.parametrize("how", [(), ("--symlink-install",)], ids=["copied", "linked"])
def test_colcon_builds_the_package_and_the_index_finds_it(tmp_path, how):
    source = shutil.copytree(ROOT / "daemon", tmp_path / "daemon", symlinks=True)
    (tmp_path / "hal").symlink_to(ROOT / "hal")
    environ = no_ros_environ(PATH=f"/usr/bin:/bin:{os.environ['PATH']}")
    run("colcon", "build", *how, "--base-paths", source / "ros2", cwd=tmp_path, env=environ)
    prefix = tmp_path / "install" / PACKAGE
    for name in LAYOUT:
        assert (prefix / name).is_file(), name
    sourced = f". {tmp_path}/install/local_setup.sh; cd /;"
    done = run("sh", "-c", f"{sourced} {program(prefix)} --help", env=environ, cwd=tmp_path)
    assert "--unstamped" in done
    index = ("/usr/bin/python3", "-c", FIND)
    if subprocess.run(["/usr/bin/python3", "-c", "import ament_index_python"],
                      capture_output=True, env=environ).returncode:  # fmt: skip
        pytest.skip("built; the index itself needs ament_index_python")
    found = run("sh", "-c", f'{sourced} exec "$@"', "sh", *index, env=environ, cwd=tmp_path)
    assert found.split() == [str(prefix), str(prefix / "share" / PACKAGE)]


def test_the_packages_metadata_match_the_projects():
    manifest = ET.parse(SOURCE / "package.xml").getroot()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert manifest.findtext("name") == PACKAGE
    assert manifest.findtext("version") == project["version"]
    assert manifest.findtext("export/build_type") == "ament_python"
    given = {
        key.arg: key.value.value
        for call in ast.walk(ast.parse((SOURCE / "setup.py").read_text()))
        if isinstance(call, ast.Call)
        for key in call.keywords
        if isinstance(key.value, ast.Constant)
    }
    assert given["version"] == project["version"]
    assert given["license"] == manifest.findtext("license") == project["license"]


def test_every_imported_ros_package_is_a_dependency():
    from motord.bus.ros2 import commands
    from motord.bus.ros2.services import lifecycle, parameters

    manifest = ET.parse(SOURCE / "package.xml").getroot()
    depends = {found.text for found in manifest.iter("exec_depend")}
    text = "".join(
        Path(module.__file__).read_text() for module in (commands, lifecycle, parameters)
    )
    kinds = {word.strip("\"'f") for word in text.replace("(", " ").replace(",", " ").split()}
    used = {kind.split("/")[0] for kind in kinds if "_msgs/" in kind or "_srvs/" in kind}
    assert used - {"motord_msgs"} <= {*depends, "rcl_interfaces"}
    assert "rclpy" in depends
