# SPDX-License-Identifier: Apache-2.0
"""Rules on which pages may see the dashboard, and which of them may command by it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.sections.bus import LOOPBACK, WebInput, WebServer
from motord.config.sections.model import Robot
from motord.config.toml_lines import Path


def _dashboards(robot: Robot) -> Iterator[tuple[Path, WebServer]]:
    for table, sections in (("publish", robot.publish), ("input", robot.input)):
        for name, section in sections.items():
            if isinstance(section, WebServer):
                yield (table, name), section


def _off_this_machine(robot: Robot) -> Iterator[Finding]:
    for path, section in _dashboards(robot):
        if section.host in LOOPBACK:
            continue
        if section.token_file is None:
            text = f"a dashboard at {section.host} is open to the network: set token_file"
            yield Finding(((*path, "token_file"), (*path, "host")), text)
        if section.cert_file is None and not section.behind_proxy:
            text = (
                f"a dashboard at {section.host} would show its token to the network: cert_file and "
                "key_file, or behind_proxy = true where a proxy encrypts"
            )
            yield Finding(((*path, "cert_file"), (*path, "host")), text)


def _commands_are_meant(robot: Robot) -> Iterator[Finding]:
    for path, section in _dashboards(robot):
        if not isinstance(section, WebInput):
            continue
        key = (*path, "trust_loopback")
        if section.trust_loopback and section.host not in LOOPBACK:
            yield Finding((key, (*path, "host")), "is only for a dashboard at 127.0.0.1")
        elif section.trust_loopback:
            text = "every user of this machine can arm and drive by it"
            yield Finding((key,), text, warning=True)
        elif section.token_file is None:
            text = (
                "pages need a token to command: set token_file, or trust_loopback = true to let "
                "every user of this machine command"
            )
            yield Finding(((*path, "token_file"), key), text)


WEB_RULES: tuple[Callable[[Robot], Iterator[Finding]], ...] = (
    _off_this_machine,
    _commands_are_meant,
)
