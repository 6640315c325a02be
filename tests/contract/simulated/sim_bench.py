# SPDX-License-Identifier: Apache-2.0
"""A simulated robot whose clock the test advances, and a raw master on its pty."""

import contextlib
import functools
import os
import select
import threading

from tests.shipped import shipped_profile

from motord_hal.fieldbus.ports import JointSpec, LineSpec, TextSpec, TextWheel
from motord_hal.modbus.codec import Function, Request, build_request, parse_reply
from motord_hal.sim.can.port import free_address
from motord_hal.sim.control import SimControl
from motord_hal.sim.plant import WheelModel
from motord_hal.sim.rig import Rig, RigSpec, WheelSpec
from motord_hal.sim.runner import run

ARRIVAL_DEADLINE_S = 60.0
"""Deadline for bytes to pass through the kernel's pty; normally they pass at once."""
CHARACTER_S = 10 / 115200
CYCLE_HZ = 100.0
"""Cycle rate of a line to simulated drives: line, drives and test share an interpreter, and on a
busy machine that gets a tenth of a CPU."""
WATCHDOG_S = 2.0
"""Watchdog time of simulated drives: some replies that a busy machine delays do not trip it."""
KINDS = {
    "modbus-rtu": "modbus-rtu",
    "ddsm": "ddsm",
    "mcu-frame": "mcu",
    "ascii": "ascii",
    "roboclaw": "roboclaw",
    "hoverboard": "hoverboard",
    "hoverboard-steer": "hoverboard",
    "sabertooth": "sabertooth",
    "can": "can",
    "feetech": "feetech",
    "dynamixel": "dynamixel",
}
GEAR = 2.0


def can_reverse(profile):
    channel = profile.channels[1]
    setpoint = profile.registers[channel.setpoint]
    return setpoint.type.signed or channel.direction is not None


def unit_of(profile):
    """Return the address of the first drive: 1, except where addresses begin elsewhere."""
    return profile.unit if profile.protocol == "sabertooth" else 1


def reports(profile):
    """Return whether the drive sends feedback: whether any of its registers can be read."""
    return any("r" in register.access for register in profile.registers.values())


def names_of(joints):
    """Return names of this number of joints: the odd ones are on the right."""
    return ("left", "right", *(f"joint{number}" for number in range(2, joints)))


def joints_of(profile, gear_ratio=1.0, joints=2):
    """Return a left and a right joint: on one drive if it has two channels, else on two units. The
    right motor is mounted in reverse if the drive can reverse. More joints are on more units."""
    paired, first = len(profile.channels) > 1, unit_of(profile)
    assert joints == 2 or not paired
    return tuple(
        JointSpec(
            index=index,
            name=name,
            profile=profile,
            unit=first if paired else first + index,
            channel=index + 1 if paired else 1,
            gear_ratio=gear_ratio,
            inverted=name == "right" and can_reverse(profile),
        )
        for index, name in enumerate(names_of(joints))
    )


RT = " rt"
"""Suffix of a drive's name in a variant on the rt engine (CAN: on the bus at a Unix socket)."""
BOTH_ENGINES = ("can",)
"""Protocols that are tested on both engines: on rt where the variant's name ends with RT."""
ON_RT = tuple(protocol for protocol in KINDS if protocol not in ("modbus-rtu", "can"))


def with_rt(names):
    """Return the names, and the rt variant of each whose protocol runs on both engines."""
    return [
        *names,
        *(name + RT for name in names if shipped_profile(name).protocol in BOTH_ENGINES),
    ]


def folder_of(variant, tmp_path):
    """Make and return the folder in which a variant of `with_rt` is simulated."""
    folder = tmp_path / ("rt" if variant.endswith(RT) else "asyncio")
    folder.mkdir()
    return folder


@functools.cache
def can_address(folder):
    """Return the address of the CAN bus of this folder; each folder has its own bus."""
    return f"unix:{folder}/bus" if folder.name == "rt" else free_address()


TEXT = TextSpec(
    setpoints="{left:.4f},{right:.4f}\n",
    feedback="{left_count:d} {left_rad_s} {right_count:d} {right_rad_s} {voltage_v}\r\n",
    wheels={"left": TextWheel(side=-1, radius_m=0.1), "right": TextWheel(side=1, radius_m=0.1)},
    track_m=0.5,
)


def engine_of(profile, folder):
    return "rt" if profile.protocol in ON_RT or folder.name == "rt" else "asyncio"


def line_of(
    profile, port="", engine="asyncio", cycle_hz=50.0, watchdog_s=0.5, gear_ratio=1.0, joints=2
):
    return LineSpec(
        index=0,
        name="bus",
        kind=KINDS[profile.protocol],
        port=str(port),
        baudrate=profile.baudrate,
        parity=profile.parity,
        stop_bits=profile.stop_bits,
        cycle_hz=cycle_hz,
        gap_s=None,
        engine=engine,
        priority=0,
        joints=joints_of(profile, gear_ratio, joints),
        text=TEXT if profile.protocol == "ascii" else None,
        watchdog_s=watchdog_s,
    )


LIGHT = WheelModel(inertia_kg_m2=0.03)
"""Wheel that friction brings to rest in 0.6 s, for tests in real time."""


def rig_of(profile, folder, *, gear_ratio=1.0, model=None, joints=2, **options):
    wheel = {"wheel_radius_m": 0.1, "model": model or WheelModel()}
    sides = ("left", "right") * joints
    wheels = {
        name: WheelSpec(side=side, **wheel)
        for name, side in zip(names_of(joints), sides, strict=False)
    }
    engine = engine_of(profile, folder)
    line = line_of(profile, engine=engine, gear_ratio=gear_ratio, joints=joints)
    if profile.can is not None:
        options["can"] = can_address(folder)
    spec = RigSpec(robot="bench", track_m=0.5, lines=(line,), wheels=wheels, **options)
    return Rig(spec, link_dir=folder)


@contextlib.contextmanager
def simulated(profile, folder, **options):
    """Simulate the robot in real time, in its own thread; yield a client of its control socket."""
    options = {"watchdog_s": 0.0 if profile.watchdog else WATCHDOG_S, "model": LIGHT, **options}
    stopped = threading.Event()
    with rig_of(profile, folder, gear_ratio=GEAR, **options) as rig:
        thread = threading.Thread(target=run, args=(rig, stopped.is_set))
        thread.start()
        try:
            with SimControl(rig.server.path) as control:
                yield control
        finally:
            stopped.set()
            thread.join()


@contextlib.contextmanager
def without_power(control, *units):
    """Take the power of these drives until the end of the block; then they start anew."""
    for unit in units:
        control.inject(f"reboot:unit={unit},for_s=1000")
    yield
    for unit in units:
        control.inject(f"reboot:unit={unit},for_s=0")


def spec_of(profile, folder, **options):
    """Return the line that drives what `simulated` simulates."""
    port = can_address(folder) if profile.can is not None else folder / "bus"
    options = {"cycle_hz": CYCLE_HZ, "watchdog_s": WATCHDOG_S, "gear_ratio": GEAR, **options}
    return line_of(profile, port, engine_of(profile, folder), **options)


class Bench:
    """A simulated rig whose time advances only in calls, and a master on its pty."""

    def __init__(self, folder, profile="zlac8015d", **options):
        self.profile = shipped_profile(profile) if isinstance(profile, str) else profile
        self.rig = rig_of(self.profile, folder, **options)
        self.line = self.rig.lines["bus"]
        self.now_s = 0.0
        self.fd = -1
        self.open()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.hang_up()
        self.rig.close()

    def open(self):
        self.fd = os.open(self.link, os.O_RDWR | os.O_NOCTTY)
        self.go_on(0.01)  # the rig notices that the port is open

    def hang_up(self):
        with contextlib.suppress(OSError):
            os.close(self.fd)

    @property
    def link(self):
        return self.line.port.link

    @property
    def drive(self):
        return self.line.drives[unit_of(self.profile)]

    def wheel(self, name="left"):
        return self.rig.plant.wheels[name]

    def go_on(self, seconds, step_s=0.001):
        """Advance time, without skipping anything that is due."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            due_s = max(self.rig.due_s(), self.now_s)
            self.now_s = min(end_s, self.now_s + step_s, due_s + 1e-6)
            self.rig.work(self.now_s)

    def send(self, frame):
        """Write bytes to the wire; the rig has received them when this returns."""
        os.write(self.fd, frame)
        assert select.select(self.line.port.filenos(self.now_s), [], [], ARRIVAL_DEADLINE_S)[0]
        self.rig.work(self.now_s)

    def receive(self, size):
        """Read exactly this many of the bytes that the rig has sent."""
        data = b""
        while len(data) < size:
            assert select.select([self.fd], [], [], ARRIVAL_DEADLINE_S)[0], data.hex(" ")
            data += os.read(self.fd, size - len(data))
        return data

    def exchange(self, frame, seconds=0.06):
        """Send a frame and return the bytes that the rig sends within this time."""
        before = self.line.wire.bytes_sent
        self.send(frame)
        self.go_on(seconds)
        return self.receive(self.line.wire.bytes_sent - before)

    def ask(self, request):
        return parse_reply(request, self.exchange(build_request(request)))

    def read(self, name, unit=1):
        """Read a register over the wire and return its SI value."""
        register = self.profile.registers[name]
        count = register.type.words
        request = Request(unit, Function.READ_HOLDING, register.address, count)
        reply = self.ask(request)
        assert reply.exception is None
        return register.to_si(register.decode(reply.values))

    def write(self, name, raw, unit=1):
        """Write a register; return the exception code, or None if the write was accepted."""
        register = self.profile.registers[name]
        words = register.encode(raw)
        function = Function.WRITE_SINGLE if len(words) == 1 else Function.WRITE_MULTIPLE
        return self.ask(Request(unit, function, register.address, values=words)).exception

    def run_steps(self, steps, unit=1):
        for step in steps:
            if step.value is not None:
                assert self.write(step.register, step.value, unit) is None
