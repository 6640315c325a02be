# SPDX-License-Identifier: Apache-2.0
"""Checks between the parts of a drive profile, so that the line need not make them."""

from __future__ import annotations

from itertools import combinations

from motord.config.drives.can_check import check_can
from motord.config.drives.problems import Problems
from motord.config.drives.unknown import check_unknown
from motord_hal.base.nearest import did_you_mean
from motord_hal.drives.profile import (
    Channel,
    Direction,
    DriveProfile,
    Gap,
    Handshake,
    Register,
    Step,
)

_SPEED_UNITS = ("rpm", "rad/s", "turn/s")
# for a channel's entry: the units of its register, and whether motord reads or writes it
_CHANNEL_RULES: dict[str, tuple[tuple[str, ...], str]] = {
    "velocity_setpoint": (_SPEED_UNITS, "w"),
    "duty_setpoint": (("percent",), "w"),
    "torque_setpoint": (("n_m",), "w"),
    "position_setpoint": (("count", "turn"), "w"),
    "position": (("count", "turn"), "r"),
    "position_least": (("count", "turn"), "r"),
    "position_greatest": (("count", "turn"), "r"),
    "velocity": (_SPEED_UNITS, "r"),
    "current": (("a",), "r"),
    "temperature": (("c",), "r"),
    "fault": (("",), "r"),
}
_SETPOINTS = [entry for entry, (_, access) in _CHANNEL_RULES.items() if access == "w"]

# DDSM: the one command whose last byte is not a check sum (motord_hal.ddsm.codec)
_UNSEALED = 0xA0
# bus servos: from this address on, a register is an instruction (motord_hal.servo.packets)
_INSTRUCTIONS = 0xFF00
_SERVOS = ("feetech", "dynamixel")
_GO_TO_POSITIONS = ("modbus-rtu", "can", "pwm", *_SERVOS)
_FRAMES = (
    "ddsm",
    "mcu-frame",
    "ascii",
    "hoverboard",
    "hoverboard-steer",
    "sabertooth",
    "pwm",
    *_SERVOS,
)
"""Protocols in which an address is a place in a frame, or (ascii, pwm) just a number."""
# bytes of a board's payloads that the line itself fills and reads (motord_hal.mcu.frames)
_BOARD_OWN = {"w": frozenset({1, 4, 5}), "r": frozenset({1, *range(4, 10)})}
_BOARD_BYTES = {"w": 6 + 6 * 8, "r": 16 + 10 * 8}
_HOVERBOARD_BYTES = {"w": 4, "r": 14}
"""Lengths of the values in its packets (motord_hal.hoverboard.codec)."""
_SABERTOOTH_TYPES = {0: "u8", 1: "i8", 2: "i8"}
"""Type of a value by its address (motord_hal.sabertooth.codec)."""


def check_profile(profile: DriveProfile, problems: Problems) -> None:
    """Add a problem for everything that does not fit together."""
    if profile.name and profile.name != profile.path.stem:
        problems.add("name", f'"{profile.name}" must be the file\'s name, "{profile.path.stem}"')
    check_unknown(profile, problems)
    if profile.can is not None:
        check_can(profile, profile.can, problems)
    else:
        _check_wire(profile, problems)
    for number, channel in profile.channels.items():
        _check_channel(profile, f"channel.{number}", channel, problems)
    _check_counter(profile, problems)
    for name in ("configure", "arm", "disarm", "quick_stop", "clear_fault"):
        _check_steps(profile, name, getattr(profile, name), problems)
    for name in ("disarm", "quick_stop"):
        if not getattr(profile, name):
            problems.add(f"steps.{name}", "must have a step: every drive can at least be sent zero")
    _check_identity(profile, problems)
    _check_enabled(profile, problems)
    _check_watchdog(profile, problems)
    _check_faults(profile, problems)
    if (profile.bridge is not None) != (profile.protocol == "pwm"):
        problems.add("bridge", 'is there if and only if protocol is "pwm"')
    if profile.bus_voltage is not None:
        _reference(profile, "bus_voltage", profile.bus_voltage, "r", ("v",), problems)


def _check_wire(profile: DriveProfile, problems: Problems) -> None:
    """Check what only a drive on a serial line has."""
    for register in profile.registers.values():
        _check_register(profile, register, problems)
    _check_overlaps(profile, problems)
    _check_serial(profile, problems)


def _check_serial(profile: DriveProfile, problems: Problems) -> None:
    if profile.gap_s is not None and profile.gap is not Gap.SPEC:
        problems.add("serial.gap", "and gap_s exclude each other")
    if profile.protocol == "modbus-rtu":
        if profile.read_write_function and profile.write_function != 16:
            problems.add(
                "serial.read_write_function",
                "a drive that has 23 has 16 too: set write_function = 16",
            )
        return
    for key, has_it in (
        ("read_write_function", profile.read_write_function),
        ("broadcast_stop", profile.broadcast_stop and profile.protocol not in _SERVOS),
    ):
        if has_it:
            problems.add(f"serial.{key}", f"{profile.protocol} has no such thing")


def _check_register(profile: DriveProfile, register: Register, problems: Problems) -> None:
    key = f"register.{register.name}"
    low, high = register.raw_range
    if register.address + register.type.words > 0x10000:
        problems.add(f"{key}.address", "the second word lies beyond 0xFFFF")
    if register.type.words > profile.max_registers and profile.protocol not in _FRAMES:
        problems.add(f"{key}.type", "is wider than serial.max_registers allows in one request")
    if register.scale == 0:
        problems.add(f"{key}.scale", "must not be zero")
        return
    for name, value in (("minimum", register.minimum), ("maximum", register.maximum)):
        if value is not None and not low <= value / register.scale <= high:
            problems.add(f"{key}.{name}", f"{value:g} does not fit {register.type.value}")
    least, most = register.minimum, register.maximum
    if least is not None and most is not None and least > most:
        problems.add(f"{key}.minimum", "is above maximum")
    if not low <= register.default <= high:
        problems.add(f"{key}.default", f"{register.default} does not fit {register.type.value}")
    if register.mask is not None:
        _check_mask(key, register, problems)
    if profile.protocol == "ddsm":
        _check_place(key, register, problems)
    elif profile.protocol == "mcu-frame":
        _check_board_place(key, register, problems)
    elif profile.protocol.startswith("hoverboard"):
        _check_packet_place(key, register, problems)
    elif profile.protocol == "sabertooth":
        _check_sabertooth_place(key, register, problems)
    elif profile.protocol in _SERVOS:
        _check_servo_register(key, register, problems)
    elif register.type.magnitude or register.type.high_first:
        problems.add(f"{key}.type", f"{register.type.value} is for bus servos")
    elif profile.protocol == "modbus-rtu" and register.type.bits < 16:
        problems.add(f"{key}.type", f"{register.type.value}: a Modbus register has 16 bits")


def _check_place(key: str, register: Register, problems: Problems) -> None:
    """Check a place in a frame of ten bytes: unit, command, content, check sum. The frame that sets
    the mode has content up to its last byte."""
    if register.access not in ("r", "w"):
        problems.add(f"{key}.access", 'a place is in the request ("w") or in the reply ("r")')
    begin, end = register.address & 0xFF, (register.address & 0xFF) + register.type.bits // 8
    first = 1 if register.access == "r" else 2
    last = 10 if register.address >> 8 == _UNSEALED else 9
    if not first <= begin < end <= last:
        problems.add(f"{key}.address", f"byte {begin} is outside the content of the frame")


def _check_servo_register(key: str, register: Register, problems: Problems) -> None:
    """Check an address in the servo's control table, or an instruction
    (motord_hal.servo.packets)."""
    if register.type.value.endswith("low-first"):
        problems.add(f"{key}.type", "of bus servos all values stand low byte first")
    if register.address >= _INSTRUCTIONS and (register.access != "w" or register.type.bits != 8):
        problems.add(f"{key}.address", 'from 0xFF00 on is an instruction: access "w", type "u8"')


def _check_board_place(key: str, register: Register, problems: Problems) -> None:
    """Check a byte of the set-points, of the feedback, or of both (docs/mcu-frame.md)."""
    place = set(range(register.address, register.address + register.type.bits // 8))
    for access in register.access:
        if place & _BOARD_OWN[access] or max(place) >= _BOARD_BYTES[access]:
            problems.add(f"{key}.address", f"{register.address} is not a valid register address")
            return


def _check_packet_place(key: str, register: Register, problems: Problems) -> None:
    """Check a word of two bytes behind the start word of the command, or of the feedback."""
    if register.access not in ("r", "w"):
        problems.add(f"{key}.access", 'a place is in the command ("w") or in the feedback ("r")')
        return
    if register.type.bits != 16:
        problems.add(f"{key}.type", f"{register.type.value}: packets consist of words of 16 bits")
    if register.address % 2 or register.address + 2 > _HOVERBOARD_BYTES[register.access]:
        problems.add(f"{key}.address", f"{register.address} is not a valid register address")


def _check_sabertooth_place(key: str, register: Register, problems: Problems) -> None:
    if register.access != "w":
        problems.add(f"{key}.access", 'must be "w": a Sabertooth sends nothing')
    if (kind := _SABERTOOTH_TYPES.get(register.address)) is None:
        problems.add(f"{key}.address", f"{register.address} is not a valid register address")
    elif register.type.value != kind:
        problems.add(f"{key}.type", f"{register.type.value}: must be {kind} at this address")


def _check_mask(key: str, register: Register, problems: Problems) -> None:
    mask = register.mask or 1
    if mask // (mask & -mask) + 1 & mask // (mask & -mask):
        problems.add(f"{key}.mask", f"{mask:#06x}: the bits must be adjacent")
    if register.access != "r" or register.type.words != 1:
        problems.add(f"{key}.mask", "only a 16-bit register that is read may have a mask")


def _check_overlaps(profile: DriveProfile, problems: Problems) -> None:
    for one, other in combinations(profile.registers.values(), 2):
        apart = one.address + _span(profile, one) <= other.address or (
            other.address + _span(profile, other) <= one.address
        )
        if profile.protocol in _FRAMES:  # what motord sends and what the drive sends are two frames
            apart = apart or not set(one.access) & set(other.access)
        shared = one.mask is not None and other.mask is not None and not one.mask & other.mask
        if not apart and not shared:
            problems.add(
                f"register.{other.name}.address",
                f"{other.address:#06x} overlaps {one.name} at {one.address:#06x}",
            )


def _span(profile: DriveProfile, register: Register) -> int:
    """Return how many addresses a register takes: bytes of a frame, or words."""
    return register.type.bits // 8 if profile.protocol in _FRAMES else register.type.words


def _reference(
    profile: DriveProfile,
    key: str,
    name: str,
    access: str,
    units: tuple[str, ...],
    problems: Problems,
) -> Register | None:
    """Return the register that a key names, or None. Add a problem if it is missing or cannot be
    used like this."""
    if not name:
        return None  # the reader has reported it
    register = profile.registers.get(name)
    if register is None:
        problems.add(key, f'no register "{name}"{did_you_mean(name, profile.registers)}')
        return None
    if register.access and access not in register.access:
        word = {"r": "read", "w": "written"}[access]
        problems.add(key, f'"{name}" cannot be {word}: its access is "{register.access}"')
    if units and register.unit not in units:
        allowed = " or ".join(f'"{unit}"' for unit in units)
        problems.add(key, f'"{name}" has the unit "{register.unit}", must be {allowed}')
    return register


def _check_channel(profile: DriveProfile, key: str, channel: Channel, problems: Problems) -> None:
    if sum(getattr(channel, entry) is not None for entry in _SETPOINTS) != 1:
        problems.add(key, f"must have exactly one of {', '.join(_SETPOINTS)}")
    if channel.torque_setpoint is not None:
        _check_torque(profile, key, channel, problems)
    if channel.position_setpoint is not None:
        _check_position(profile, key, channel, problems)
    setpoint = None
    for entry, (units, access) in _CHANNEL_RULES.items():
        name = getattr(channel, entry)
        if name is None:
            continue
        register = _reference(profile, f"{key}.{entry}", name, access, units, problems)
        if access == "w":
            setpoint = register
    if setpoint is not None:
        _check_setpoint(profile, key, setpoint, channel.direction, problems)
        _check_together(profile, f"{key}.setpoint_with", setpoint, channel, problems)
    if channel.direction is not None:
        _check_direction(profile, f"{key}.direction", channel.direction, problems)
    if channel.handshake is not None:
        _check_handshake(profile, f"{key}.handshake", setpoint, channel.handshake, problems)


def _check_torque(profile: DriveProfile, key: str, channel: Channel, problems: Problems) -> None:
    """Check a torque: the core closes the loop, so it needs the speed, and torque in both
    directions."""
    if profile.protocol != "can":
        problems.add(key, f'torque_setpoint: not with protocol "{profile.protocol}"')
    if channel.velocity is None:
        problems.add(key, "torque_setpoint needs velocity: a speed loop is closed over it")
    setpoint = profile.registers.get(channel.torque_setpoint or "")
    if setpoint is not None and None in (setpoint.minimum, setpoint.maximum):
        problems.add(key, f'torque_setpoint: "{setpoint.name}" needs minimum and maximum')
    if channel.direction is not None:
        problems.add(key, "torque_setpoint goes without direction: it has a sign")


def _check_position(profile: DriveProfile, key: str, channel: Channel, problems: Problems) -> None:
    """Check a position: the drive is armed at the place where it is, and moved only from a known
    place."""
    if profile.protocol not in _GO_TO_POSITIONS:
        problems.add(key, f'position_setpoint: not with protocol "{profile.protocol}"')
        return
    if profile.protocol == "pwm":
        return
    if channel.move_velocity is not None:
        key_of = f"{key}.move_velocity"
        _reference(profile, key_of, channel.move_velocity, "w", _SPEED_UNITS, problems)
        written = {step.register for step in profile.configure if step.value is not None}
        if channel.move_velocity not in written | dict(channel.setpoint_with).keys():
            problems.add(key_of, "no step of configure writes it, and setpoint_with does not")
    if (channel.position_least is None) != (channel.position_greatest is None):
        problems.add(key, "position_least and position_greatest go together")
    target = profile.registers.get(channel.position_setpoint or "")
    position = profile.registers.get(channel.position or "")
    if channel.position is None:
        problems.add(key, "position_setpoint needs position: it begins where the motor is")
    elif target and position and (target.unit, target.scale) != (position.unit, position.scale):
        problems.add(key, "position_setpoint and position differ in unit or scale")
    if position is not None and position.mask is not None:
        problems.add(key, "position_setpoint: its position is a whole register, without mask")
    if profile.absolute == (profile.homed is not None):
        problems.add(key, "position_setpoint needs either absolute = true, or [homed]")
    if profile.read_write_function is not None:
        problems.add("serial.read_write_function", "is not for positions: they are not always sent")
    if channel.direction is not None:
        problems.add(key, "position_setpoint goes without direction: it has a sign")
    if any(one.position_setpoint is None for one in profile.channels.values()):
        problems.add(key, "position_setpoint: all channels take positions, or none does")


def _check_setpoint(
    profile: DriveProfile,
    key: str,
    register: Register,
    direction: Direction | None,
    problems: Problems,
) -> None:
    narrow = profile.write_function == 6 and profile.protocol == "modbus-rtu"
    if register.type.words == 2 and narrow:
        problems.add(key, "a 32-bit set-point cannot be written with function 6")
    if direction is not None and register.type.signed:
        problems.add(f"{key}.direction", "the set-point is signed: it needs no direction")
    low, high = register.minimum, register.maximum
    rests_at_zero = register.unit not in _CHANNEL_RULES["position_setpoint"][0]
    if rests_at_zero and ((low is not None and low > 0) or (high is not None and high < 0)):
        problems.add(key, f'the set-point "{register.name}" has no zero in its range')


def _check_together(
    profile: DriveProfile, key: str, setpoint: Register, channel: Channel, problems: Problems
) -> None:
    """Check that one request carries all these registers: the drive never acts on half of it."""
    if not channel.setpoint_with:
        return
    words = set(range(setpoint.address, setpoint.address + setpoint.type.words))
    for name, _ in channel.setpoint_with:
        register = _reference(profile, f"{key}.{name}", name, "w", (), problems)
        if register is None:
            return
        words |= set(range(register.address, register.address + register.type.words))
    if max(words) - min(words) + 1 != len(words):
        problems.add(key, "these registers and the set-point's must lie side by side")
    if profile.write_function != 16 or len(words) > profile.max_registers:
        problems.add(key, f"needs write_function = 16 and max_registers = {len(words)} or more")


def _check_handshake(
    profile: DriveProfile,
    key: str,
    setpoint: Register | None,
    handshake: Handshake,
    problems: Problems,
) -> None:
    """Check that the bit is in the frame of the set-point, and that its acknowledgement can be
    read."""
    if profile.can is None or setpoint is None or setpoint.unit not in ("count", "turn"):
        problems.add(key, "is for a position_setpoint on a CAN bus")
        return
    trigger = _reference(profile, f"{key}.register", handshake.register, "w", ("",), problems)
    if trigger is not None and trigger.address != setpoint.address:
        problems.add(f"{key}.register", f'"{trigger.name}" is not in the frame of the set-point')
    if handshake.mask.bit_count() != 1:
        problems.add(f"{key}.mask", f"{handshake.mask:#x} is not one bit")
    acknowledges = _reference(
        profile, f"{key}.acknowledged", handshake.acknowledged, "r", ("",), problems
    )
    for register, mask in (
        (trigger, handshake.mask),
        (acknowledges, handshake.acknowledged_mask),
    ):
        if register is not None and mask >> register.type.bits:
            problems.add(key, f"{mask:#x} does not fit {register.name}")


def _check_direction(
    profile: DriveProfile, key: str, direction: Direction, problems: Problems
) -> None:
    _reference(profile, f"{key}.register", direction.register, "w", ("",), problems)
    if len({direction.forward, direction.reverse, direction.rest}) != 3:
        problems.add(key, "forward, reverse and rest must be three different values")


def _check_counter(profile: DriveProfile, problems: Problems) -> None:
    # whether a text board reports counts, and how many, is only in the robot file
    by_joint = profile.protocol == "ascii" and profile.counts_per_turn == 0
    if (profile.counts_per_turn == 0) != (profile.counter_bits == 0) and not by_joint:
        problems.add("motor", "counts_per_turn and counter_bits are both zero or both not")
    for number, channel in profile.channels.items():
        if (channel.position is None) != (profile.counter_bits == 0):
            problems.add(f"channel.{number}.position", "is there if and only if counter_bits > 0")
        register = profile.registers.get(channel.position or "")
        if register is not None and profile.counter_bits > register.type.bits:
            problems.add("motor.counter_bits", f"is wider than {register.name}")


def _check_steps(
    profile: DriveProfile, name: str, steps: tuple[Step, ...], problems: Problems
) -> None:
    for index, step in enumerate(steps):
        key = f"steps.{name}[{index}]"
        register = _reference(
            profile, key, step.register, "r" if step.value is None else "w", (), problems
        )
        if step.value is None and step.equals is not None and step.equals & ~step.mask:
            problems.add(key, f"never true: {step.equals:#x} has bits outside {step.mask:#x}")
        if register is None or step.value is None:
            continue
        if step.cycle and (register.unit not in ("s", "ms") or name != "configure"):
            problems.add(key, "cycle is for a time, and only in configure")
        if step.cycle and profile.can is None:
            problems.add(key, f"{profile.protocol} has no such thing as cycle")
        if step.if_different and (profile.protocol not in _SERVOS or name != "configure"):
            problems.add(key, "if_different is for bus servos, and only in configure")
        if step.if_different and "r" not in register.access:
            problems.add(key, f'if_different: "{register.name}" cannot be read')
        low, high = register.raw_range
        if not low <= step.value <= high:
            problems.add(key, f"{step.value} does not fit {register.name}")


def _check_enabled(profile: DriveProfile, problems: Problems) -> None:
    for key in ("enabled", "power_off", "homed"):
        place = getattr(profile, key)
        if place is None:
            continue
        _reference(profile, f"{key}.register", place.register, "r", (), problems)
        if place.equals & ~place.mask:
            never = f"never true: {place.equals:#x} has bits outside {place.mask:#x}"
            problems.add(key, never)


def _check_identity(profile: DriveProfile, problems: Problems) -> None:
    for number, one in enumerate(profile.identity):
        key = f"identity[{number}]"
        _reference(profile, f"{key}.register", one.register, "r", (), problems)
        if not one.values:
            problems.add(f"{key}.values", "there is no value")
        for value in one.values:
            if value & ~one.mask:
                problems.add(key, f"never true: {value:#x} has bits outside {one.mask:#x}")


def _check_watchdog(profile: DriveProfile, problems: Problems) -> None:
    watchdog = profile.watchdog
    if (watchdog is None) != bool(profile.watchdog_note):
        problems.add("watchdog", "give either [watchdog] or watchdog_note (why there is none)")
    if watchdog is None:
        return
    if profile.watchdog_fixed_s:
        problems.add("watchdog_fixed_s", "is for a drive without [watchdog]")
    units = ("s", "ms")
    register = _reference(profile, "watchdog.register", watchdog.register, "w", units, problems)
    if watchdog.minimum_s > watchdog.maximum_s:
        problems.add("watchdog.minimum_s", "is above maximum_s")
    if register is None or register.scale == 0:
        return
    if "r" not in register.access and profile.protocol != "sabertooth":
        problems.add("watchdog.register", "must be readable: it is read back after it was written")
    for name, seconds in (("minimum_s", watchdog.minimum_s), ("maximum_s", watchdog.maximum_s)):
        raw = register.from_si(seconds)
        low, high = register.raw_range
        if not low <= raw <= high or raw == 0 or abs(register.to_si(raw) - seconds) > seconds / 2:
            problems.add(f"watchdog.{name}", f"{seconds:g} s cannot be written to {register.name}")


def _check_faults(profile: DriveProfile, problems: Problems) -> None:
    words = {channel.fault for channel in profile.channels.values()} - {None}
    if bool(words) != bool(profile.faults):
        problems.add("fault", "fault bits and a channel's fault register go together")
    if len({fault.bit is None for fault in profile.faults}) > 1:
        problems.add("fault", "all by bit, or all by code")
    seen = set()
    for index, fault in enumerate(profile.faults):
        if (fault.bit, fault.code) in seen:
            problems.add(f"fault[{index}]", "is listed twice")
        seen.add((fault.bit, fault.code))
        for name in words:
            register = profile.registers.get(name or "")
            if register and fault.bit is not None and fault.bit >= register.type.bits:
                problems.add(f"fault[{index}].bit", f"{fault.bit} is beyond {register.name}")
