# SPDX-License-Identifier: Apache-2.0
"""Robots for units, one of each kind of line, with their simulated drives or the kernel's pins."""

import contextlib
import dataclasses
import re

from cable import ROBOT, UART, Bridge, adapter, behind, plug, robot_file
from hardware import simulated
from pin_rig import LABEL, LINES, pins
from shell import DEADLINE_S, output
from unit import ETC

from motord_hal.sim.control import SimControl

CONFIG = ROBOT.parent
SLOW = (
    ("command_timeout_s = 0.3", "command_timeout_s = 5.0"),
    ("feedback_timeout_s = 0.25", "feedback_timeout_s = 5.0"),
    ("heartbeat_timeout_s = 0.5", "heartbeat_timeout_s = 5.0\ntimeout_travel_max_m = 1000.0"),
    ("drive_watchdog_s = 0.5", "drive_watchdog_s = 8.0"),
    ("rate_hz = 1000", "rate_hz = 50"),
)
"""A machine that is late for seconds is no fault; the drives' own watchdogs act later still."""


@dataclasses.dataclass
class Truth:
    at_rest: bool
    joints: dict


@dataclasses.dataclass
class Pins:
    """What a simulator would report, for a robot on pins: whether it has power and pulses."""

    rig: object

    @dataclasses.dataclass
    class Joint:
        velocity_rad_s: float
        enabled: bool

    def truth(self):
        powered = [self.rig.level(enable) for enable in ("PIN0", "PIN2")]
        pulses = [self.rig.level("pwm0") + self.rig.level("pwm1"),
                  self.rig.level("pwm2") + self.rig.level("pwm3")]  # fmt: skip
        joints = {
            name: self.Joint(18.0 * on * duty, on > 0.0)
            for name, on, duty in zip(("left", "right"), powered, pulses, strict=True)
        }
        return Truth(not any(joint.velocity_rad_s for joint in joints.values()), joints)


def written(source, name, *changes, more=""):
    """The robot file of a unit, made from a shipped one."""
    text = (CONFIG / source).read_text(encoding="utf-8")
    changes = (*changes, (f'name = "{source.removesuffix(".toml")}"', f'name = "{name}"'))
    for old, new in (*SLOW, *changes):
        text = text.replace(old, new)
    for _, new in changes:
        assert new in text, f"{source}: {new}"
    path = ETC / f"{name}.toml"
    path.write_text(text + more, encoding="utf-8")
    return path


@contextlib.contextmanager
def modbus(name):
    plug()
    robot = robot_file(ETC, UART, name=name)
    with (
        simulated(ROBOT) as simulator,
        behind(simulator, adapter()) as sim,
    ):
        yield sim, robot
    for path in (robot, ETC / "zlac8015d.toml"):
        path.unlink()


@contextlib.contextmanager
def can(name):
    output("ip", "link", "add", "vxcan8", "type", "vxcan", "peer", "name", "vxcan9")
    for interface in ("vxcan8", "vxcan9"):
        output("ip", "link", "set", interface, "up")
    text = (CONFIG.parent / "drives/odrive-0.6.toml").read_text(encoding="utf-8")
    profile = ETC / "odrive-0.6.toml"
    profile.write_text(re.sub(r"silence_s = .*", "silence_s = 5.0", text), encoding="utf-8")
    robot = written(
        "odrive-two.toml",
        name,
        ("cycle_hz = 100", "cycle_hz = 10"),
        ('channel = "can0"', 'channel = "vxcan8"'),
        ('drive = "odrive-0.6"', f'drive = "./{profile.name}"'),
    )
    options = ("--can", "socketcan:vxcan9")
    with simulated(robot, options=options) as simulator:
        yield simulator.control, robot
    robot.unlink()
    profile.unlink()
    output("ip", "link", "del", "vxcan8")


@contextlib.contextmanager
def board(name):
    plug()
    robot = written(
        "esp32.toml",
        name,
        ('port = "/dev/ttyUSB0"', f'port = "{UART}"'),
        ("cycle_hz = 100", "cycle_hz = 10"),
        ("drive_watchdog_s = 0.25", "drive_watchdog_s = 2.0\nfeedback_timeout_s = 5.0"),
    )
    with simulated(robot) as simulator:
        control = SimControl(simulator.control_path, timeout_s=DEADLINE_S)
        with Bridge(simulator.ports["board"], adapter()), contextlib.closing(control):
            yield control, robot
    robot.unlink()


@contextlib.contextmanager
def pwm(name, more=""):
    with pins() as rig:
        robot = written(
            "pi5-bts7960.toml",
            name,
            ("1f00098000.pwm", rig.pwm_chip),
            ("pinctrl-rp1", LABEL),
            ('"GPIO5"', f'"{LINES[0]}"'),
            ('"GPIO6"', f'"{LINES[1]}"'),
            ('"GPIO16"', f'"{LINES[2]}"'),
            ('"GPIO26"', f'"{LINES[3]}"'),
            ('"GPIO17"', f'"{LINES[4]}"'),
            ('"GPIO27"', f'"{LINES[5]}"'),
            ('"GPIO23"', f'"{LINES[6]}"'),
            ('"GPIO24"', f'"{LINES[7]}"'),
            more=more,
        )
        yield Pins(rig), robot
    robot.unlink()


KINDS = {"modbus": modbus, "can": can, "mcu": board, "pwm": pwm}
