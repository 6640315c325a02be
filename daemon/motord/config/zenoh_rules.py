# SPDX-License-Identifier: Apache-2.0
"""What must hold between the keys of a ROS 2 node on Zenoh: above all, who may command by it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.bus_sections import LOOPBACK, ZenohInput, ZenohNode
from motord.config.finding import Finding
from motord.config.model import Robot
from motord.config.toml_lines import Path


def _zenoh_nodes(robot: Robot) -> Iterator[tuple[Path, ZenohNode]]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, ZenohNode):
                yield (table, name), section


def _zenoh_commands_are_meant(robot: Robot) -> Iterator[Finding]:
    for path, section in _zenoh_nodes(robot):
        if not isinstance(section, ZenohInput):
            continue
        if not section.trust_router:
            text = "all whom the router lets in could move the robot: trust_router = true, if meant"
            yield Finding(((*path, "trust_router"), (*path, "router")), text)
        if section.router_host not in LOOPBACK and not section.encrypted:
            text = f"commands by {section.router_host} would cross the network unprotected: tls/"
            yield Finding(((*path, "router"),), text)


def _zenoh_routers(robot: Robot) -> Iterator[Finding]:
    routers: dict[tuple[str, str, int], tuple[Path, ZenohNode]] = {}
    keys = ("router", "ca_file", "cert_file", "key_file")
    for path, section in _zenoh_nodes(robot):
        if (section.cert_file is None) != (section.key_file is None):
            key = "key_file" if section.key_file is None else "cert_file"
            yield Finding(((*path, key),), "cert_file and key_file go together")
        for key in keys[1:]:
            if getattr(section, key) is not None and not section.encrypted:
                yield Finding(((*path, key), (*path, "router")), "is of no use without tls/")
        node = (section.node_name, section.namespace, section.domain_id)
        before, first = routers.setdefault(node, (path, section))
        for key in keys:
            if getattr(section, key) != getattr(first, key):
                text = f"a node has one router: {'.'.join(map(str, before))} says another"
                yield Finding(((*path, key), (*before, key)), text)


ZENOH_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _zenoh_commands_are_meant,
    _zenoh_routers,
)
