# SPDX-License-Identifier: Apache-2.0
"""`motord ros2-msgs`: write the ROS 2 package of motord's own types."""

from __future__ import annotations

from pathlib import Path

import click

from motord.cli.common import Exit, Failure
from motord.tools.ros2_msgs import PACKAGE, write_package


@click.command("ros2-msgs")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def ros2_msgs(folder: Path) -> None:
    """Write the ROS 2 package motord_msgs into DIR, the src of a colcon workspace.

    With it, ros2 topic echo shows motor_status, and ros2 action send_goal accepts drive_distance. A
    package that is there already is left as it is: remove it first.

    \b
    Example: motord ros2-msgs ros2_ws/src && cd ros2_ws && colcon build
    """
    try:
        package = write_package(folder)
    except FileExistsError as error:
        raise Failure(f"{error.filename} is there already: remove it first", Exit.USAGE) from None
    except OSError as error:
        raise Failure(f"{error.filename}: {error.strerror}") from error
    click.echo(f"{package}: written. Next, in the workspace:")
    click.echo(f"  colcon build --packages-select {PACKAGE} && source install/setup.bash")
