# SPDX-License-Identifier: Apache-2.0
"""Describes in words the bytes to and from boards, motor drivers, bus servos and hub motors, with
the codecs of the lines and the simulator. A stream comes in pieces: each decoder keeps the bytes of
an incomplete frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeAlias

from motord.config import Robot
from motord.config.wiring import line_specs
from motord.tools.trace.exchanges import Exchange, Words
from motord_hal.ascii.dialect import texts_of
from motord_hal.ascii.text import Lines
from motord_hal.ddsm import codec as ddsm
from motord_hal.drives.profile import DriveProfile, Register
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.hoverboard import codec as hoverboard
from motord_hal.mcu import frames as mcu
from motord_hal.modbus.codec import Function
from motord_hal.roboclaw import codec as roboclaw
from motord_hal.sabertooth import codec as sabertooth
from motord_hal.servo import packets as servo

BoardDecoder: TypeAlias = Callable[[Exchange], Words]


def board_decoder(kind: str, robot: Robot, line: str) -> BoardDecoder | None:
    """Return the decoder for a line of this kind; None: the line is Modbus or CAN, or there is no
    decoder for its kind."""
    spec = next((one for one in line_specs(robot, robot.profiles) if one.name == line), None)
    makers: dict[str, Callable[[LineSpec], BoardDecoder]] = {
        "mcu": _Frames, "ascii": _Texts, "roboclaw": _roboclaw_of, "ddsm": _ddsm_of,
        "feetech": _Servos, "dynamixel": _Servos, "hoverboard": _Hoverboard,
        "sabertooth": _Sabertooth,
    }  # fmt: skip
    return makers[kind](spec) if spec is not None and kind in makers else None


def _end(exchange: Exchange, problems: Sequence[str], shown: Sequence[str]) -> str:
    """Return the result of an exchange in a protocol that has no reply for each request."""
    if problems:
        return problems[0]
    if not exchange.outward:
        return "in" if shown else "part of a frame"
    return "ok" if exchange.received else "out"


def _values(registers: Sequence[Register], pick: Callable[[Register], int]) -> Iterator[str]:
    for register in registers:
        try:
            yield f"{register.name} {register.to_si(pick(register)):g}"
        except ValueError:
            continue  # the frame is too short for this register


# ---------------------------------------------------------------------- frames of docs/mcu-frame.md
class _Frames:
    """Decodes set-points and feedback of a board."""

    def __init__(self, spec: LineSpec) -> None:
        self._joints = ",".join(joint.name for joint in spec.joints)
        self._registers = list(spec.joints[0].profile.registers.values())
        self._splitters = {True: mcu.Splitter(), False: mcu.Splitter()}

    def __call__(self, exchange: Exchange) -> Words:
        shown: list[str] = []
        problems: list[str] = []
        for outward, data in ((True, exchange.sent), (False, exchange.received)):
            for piece in self._splitters[outward].feed(data):
                try:
                    shown.append(self._frame(mcu.parse(piece)))
                except mcu.FrameError as error:
                    problems.append(f"bad frame: {error}")
        return Words(self._joints, "; ".join(shown), _end(exchange, problems, shown))

    def _frame(self, frame: mcu.Frame) -> str:
        access = "w" if frame.type == mcu.Type.SETPOINTS else "r"
        registers = [one for one in self._registers if access in one.access]
        values = ", ".join(_values(registers, lambda one: mcu.pick(frame.payload, one)))
        name = "set-points" if access == "w" else "feedback"
        return f"{name} {frame.sequence}: {values}"


# ------------------------------------------------------------------------------------ lines of text
class _Texts:
    """Decodes lines of text by the templates of the robot file."""

    def __init__(self, spec: LineSpec) -> None:
        self._joints = ",".join(joint.name for joint in spec.joints)
        _, self._sent, self._received = texts_of(spec)
        self._lines = Lines()

    def __call__(self, exchange: Exchange) -> Words:
        shown = [self._words(line, outward=True) for line in Lines.whole(exchange.sent)]
        shown += [self._words(line, outward=False) for line in self._lines.feed(exchange.received)]
        return Words(self._joints, "; ".join(shown), _end(exchange, [], shown))

    def _words(self, line: bytes, *, outward: bool) -> str:
        text = self._sent if outward else self._received
        found = text.read(line) if text is not None else None
        if found is None:
            return line.decode("ascii", "replace").strip()
        name = "set-points" if outward else "feedback"
        return f"{name}: {', '.join(f'{field} {value:g}' for field, value in found.items())}"


# ----------------------------------------------------------------------------------------- RoboClaw
def _roboclaw_of(spec: LineSpec) -> BoardDecoder:
    def words(exchange: Exchange) -> Words:
        try:
            request = roboclaw.parse_packet(exchange.sent)
        except roboclaw.PacketError as error:
            problem = f"not expected: {error}" if exchange.sent else "came without a request"
            return Words("", "", problem)
        joints = [joint for joint in spec.joints if joint.unit == request.unit]
        names = ",".join(joint.name for joint in joints) or f"unit {request.unit}"
        profile = joints[0].profile if joints else None
        reads = request.function is Function.READ_HOLDING
        address = request.address
        what = f"read command {roboclaw.reading_command(request)}"
        if not reads:
            what = f"write {registers_words(profile, address, request.values)}"
        if not exchange.received:
            return Words(names, what, "no reply")
        try:
            values = roboclaw.parse(request, exchange.received)
        except roboclaw.PacketError as error:
            return Words(names, what, f"bad reply: {error}")
        return Words(names, f"{what} → {registers_words(profile, address, values)}" if reads
                     else what, "ok")  # fmt: skip

    return words


# ------------------------------------------------- hoverboard packets, Sabertooth packet serial
class _Hoverboard:
    """Decodes commands to a hoverboard's main board, as its firmware mixes them, and feedback."""

    def __init__(self, spec: LineSpec) -> None:
        self._joints = ",".join(joint.name for joint in spec.joints)
        self._profile = spec.joints[0].profile
        self._sent = hoverboard.Splitter(hoverboard.COMMAND_BYTES)
        self._received = hoverboard.Splitter(hoverboard.FEEDBACK_BYTES)

    def __call__(self, exchange: Exchange) -> Words:
        sent = list(self._sent.feed(exchange.sent))
        received = list(self._received.feed(exchange.received))
        shown = [f"set-points: {self._command(one)}" for one in sent if one is not None]
        shown += [f"feedback: {self._feedback(one)}" for one in received if one is not None]
        problems = ["bad packet: wrong check sum"] if None in (*sent, *received) else []
        return Words(self._joints, "; ".join(shown), _end(exchange, problems, shown))

    def _command(self, values: bytes) -> str:
        raw = hoverboard.commanded(self._profile, values)
        return _by_name(self._profile, raw)

    def _feedback(self, values: bytes) -> str:
        registers = [one for one in self._profile.registers.values() if "r" in one.access]
        return ", ".join(_values(registers, lambda one: hoverboard.pick(values, one)))


class _Sabertooth:
    """Decodes packets to the drivers on one wire, each with its address. Drivers send nothing."""

    def __init__(self, spec: LineSpec) -> None:
        self._drivers = {
            joint.unit: (joint.profile, sabertooth.Receiver(joint.profile, joint.unit))
            for joint in spec.joints
        }
        self._names = {
            unit: ",".join(joint.name for joint in spec.joints if joint.unit == unit)
            for unit in self._drivers
        }

    def __call__(self, exchange: Exchange) -> Words:
        names: list[str] = []
        shown: list[str] = []
        problems: list[str] = []
        for unit, (profile, receiver) in self._drivers.items():
            packets = list(receiver.feed(exchange.sent))
            whole = [_by_name(profile, one) for one in packets if one]
            if whole:
                names.append(self._names[unit])
                shown += whole
            if None in packets:
                problems.append("bad packet: wrong check sum")
        if exchange.received:
            problems.append("not expected: a Sabertooth sends nothing")
        what = f"write {', '.join(shown)}" if shown else ""
        return Words(",".join(names), what, _end(exchange, problems, shown))


def _by_name(profile: DriveProfile, raw: Mapping[str, int]) -> str:
    """Return the names of the registers with their SI values."""
    return ", ".join(f"{name} {profile.registers[name].to_si(n):g}" for name, n in raw.items())


# --------------------------------------------------------------------------- hub motors (ten bytes)
def _ddsm_of(spec: LineSpec) -> BoardDecoder:
    def words(exchange: Exchange) -> Words:
        frame, size = exchange.sent, ddsm.FRAME_BYTES
        if len(frame) != size:
            return Words("", "", "not expected: no frame of ten bytes")
        joints = [joint for joint in spec.joints if joint.unit == frame[0]]
        names = ",".join(joint.name for joint in joints) or f"unit {frame[0]}"
        registers = list(joints[0].profile.registers.values()) if joints else []
        what = f"command {frame[1]:02X}h: {_ddsm_values(registers, frame[1], frame, 'w')}"
        if not ddsm.is_answered(frame[1]):
            return Words(names, what, "out")
        if not exchange.received:
            return Words(names, what, "no reply")
        reply = exchange.received[-size:]
        if not ddsm.sealed(reply):
            return Words(names, what, "bad reply: wrong check sum")
        return Words(names, f"{what} → {_ddsm_values(registers, frame[1], reply, 'r')}", "ok")

    return words


def _ddsm_values(registers: Sequence[Register], command: int, frame: bytes, access: str) -> str:
    fitting = [one for one in registers if access in one.access and ddsm.command_of(one) == command]
    return ", ".join(_values(fitting, lambda one: ddsm.pick(frame, one)))


# --------------------------------------------------------------------------------------- bus servos
_READS_OF_ALL = (servo.Instruction.SYNC_READ, servo.Instruction.FAST_SYNC_READ)


class _Servos:
    """Decodes Feetech and Dynamixel packets; a status is decoded with the request before it."""

    def __init__(self, spec: LineSpec) -> None:
        self._packets = servo.packets_of(spec.kind)
        self._number_bytes = len(self._packets.number(0))
        self._joints = {joint.unit: (joint.name, joint.profile) for joint in spec.joints}
        self._any = spec.joints[0].profile

    def __call__(self, exchange: Exchange) -> Words:
        names: list[str] = []
        shown: list[str] = []
        problems: list[str] = []
        first: int | None = None
        size = 0
        for packet in servo.take_all(self._packets, exchange.sent):
            if packet is None:
                problems.append("not expected: wrong check sum")
                continue
            text, first, size = self._request(packet)
            names.append(self._name(packet.unit))
            shown.append(text)
        answered = 0
        for status in self._statuses(exchange):
            if status is None:
                problems.append("bad reply: wrong check sum")
                continue
            is_of_all = status.unit == servo.BROADCAST_UNIT
            for one in servo.split_fast_status(status, size) if is_of_all else [status]:
                answered += 1
                shown.append(f"→ {self._status(one, first)}")
                problems += self._problems(one)
        if size and not answered and not problems:
            problems.append("no reply")
        if not exchange.sent and answered:
            problems.append("came without a request")
        return Words(
            ",".join(dict.fromkeys(names)), "; ".join(shown), _end(exchange, problems, shown)
        )

    def _problems(self, status: servo.Packet) -> list[str]:
        if not status.code:
            return []
        name = servo.DYNAMIXEL_ERRORS.get(status.code & 0x7F, "see the servo's manual")
        return [f"{self._name(status.unit)}: error {status.code} ({name})"]

    def _name(self, unit: int) -> str:
        if unit == servo.BROADCAST_UNIT:
            return "all"
        return self._joints[unit][0] if unit in self._joints else f"unit {unit}"

    def _number(self, data: bytes, at: int) -> int:
        """Return number `at` (from 0) of the addresses and counts in a packet's parameters."""
        begin = at * self._number_bytes
        return int.from_bytes(data[begin : begin + self._number_bytes], "little")

    def _request(self, packet: servo.Packet) -> tuple[str, int, int]:
        """Return the description of a request, and the address and number of bytes that it reads;
        number 0: it reads nothing."""
        data, width = packet.parameters, self._number_bytes
        first = self._number(data, 0)
        if packet.code in (servo.Instruction.READ, *_READS_OF_ALL):
            size = self._number(data, 1)
            units = data[2 * width :] if packet.code in _READS_OF_ALL else b""
            of = f" of {', '.join(self._name(unit) for unit in units)}" if units else ""
            return f"read {size} bytes from {first}{of}", first, size
        if packet.code == servo.Instruction.WRITE:
            profile = self._joints.get(packet.unit, ("", self._any))[1]
            return f"write {_servo_values(profile, first, data[width:])}", 0, 0
        if packet.code == servo.Instruction.SYNC_WRITE:
            size, rest = self._number(data, 1), data[2 * width :]
            pieces = [rest[at : at + size + 1] for at in range(0, len(rest) - size, size + 1)]
            parts = [
                f"{self._name(one[0])}: {_servo_values(self._any, first, one[1:])}"
                for one in pieces
            ]
            return f"write {'; '.join(parts)}", 0, 0
        known = {one.value: one.name.lower().replace("_", " ") for one in servo.Instruction}
        text = known.get(packet.code, f"instruction {packet.code:02X}h")
        return text, 0, int(packet.code == servo.Instruction.PING)

    def _status(self, status: servo.Packet, first: int | None) -> str:
        if first is None:
            return f"{self._name(status.unit)}: {status.parameters.hex(' ')}"
        profile = self._joints.get(status.unit, ("", self._any))[1]
        return f"{self._name(status.unit)}: {_servo_values(profile, first, status.parameters)}"

    def _statuses(self, exchange: Exchange) -> Iterator[servo.Packet | None]:
        data = exchange.received.removeprefix(exchange.sent)  # without an adapter's echo
        return servo.take_all(self._packets, data, status=True)


def _servo_values(profile: DriveProfile, first: int, data: bytes) -> str:
    """Return names and SI values of the registers in these bytes; `first` is the first address."""
    registers = [
        one
        for one in profile.registers.values()
        if first <= one.address and one.address + servo.size_bytes(one) <= first + len(data)
    ]
    return ", ".join(_values(registers, lambda one: servo.decode(one, data[one.address - first :])))


# ------------------------------------------------------------------------------- registers of words
def registers_words(profile: DriveProfile | None, start: int, values: Sequence[int]) -> str:
    """Return names and SI values of the registers in these words, then the other words in hex.
    `start` is the first address."""
    shown, known = [], set[int]()
    registers: Sequence[Register] = list(profile.registers.values()) if profile else ()
    for register in registers:
        first = register.address - start
        if first >= 0 and first + register.type.words <= len(values):
            raw = register.decode(tuple(values[first : first + register.type.words]))
            shown.append(f"{register.name} {register.to_si(raw):g}")
            known |= set(range(first, first + register.type.words))
    others = [f"{start + n:04X}h {value:04X}h" for n, value in enumerate(values) if n not in known]
    return ", ".join(shown + others)
