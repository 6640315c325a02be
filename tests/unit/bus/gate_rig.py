# SPDX-License-Identifier: Apache-2.0
"""A command gate of the demo robot."""

from pathlib import Path

from motord.bus.commands.gate import CommandGate
from motord.bus.runtime import Runtime
from motord.config import MqttInput, load_robot

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"


def gate(tmp_path_factory, robot=DEMO, **settings):
    token = tmp_path_factory.mktemp("gate") / "token"
    token.write_text("x" * 20, encoding="ascii")
    token.chmod(0o600)
    section = MqttInput(kind="mqtt", token_file=str(token), **settings)
    return CommandGate("fleet", section, Runtime(load_robot(robot), token.with_name("no.sock")))
