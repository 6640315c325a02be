# SPDX-License-Identifier: Apache-2.0
"""The interface to the thread that drives motor bridges. The meaning of each field is in
csrc/api/line/api_bridge.h."""

from __future__ import annotations

import dataclasses
import enum
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from _motord_rt import ffi, lib

from motord_hal.base.errors import HalError
from motord_hal.realtime.drive_state import FaultReason
from motord_hal.realtime.exchange import Exchange, value_of

MODES = ("coast", "brake", "forward", "reverse")
"""The modes of a bridge, in the order of the enum in C."""


class BridgeMode(enum.IntEnum):
    OFF = lib.PWM_OFF
    STOP = lib.PWM_STOP
    ARMED = lib.PWM_ARMED


_NEVER = FaultReason(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pin:
    """One output pin."""

    joint: int
    """Index in `BridgeConfig.joints`."""
    fd: int
    """File descriptor of the PWM channel's duty_cycle; -1: the pin is a GPIO line."""
    bit: int
    inverted: bool
    period_ns: int
    levels: dict[str, tuple[float, float]]
    """Mode → (base, slope): the level is base + slope × |duty|."""
    pumps: bool = False
    """True: the pin changes in every cycle while the motor may move, and ignores `levels`."""


class EncoderKind(enum.IntEnum):
    NONE = lib.ENCODER_NONE
    EDGES = lib.ENCODER_EDGES
    COUNTER = lib.ENCODER_COUNTER
    REPORTED = lib.ENCODER_REPORTED


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderConfig:
    """Data of one encoder; csrc/api/api_encoder.h has the meaning of each field."""

    kind: EncoderKind
    fd: int
    a_offset: int = 0
    b_offset: int = 0
    levels: int = 0
    ceiling: int = 0
    rad_per_count: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeJoint:
    index: int
    """Number of the joint in the core."""
    brakes_at_rest: bool
    inverted: bool
    fault_mask: int
    encoder: EncoderConfig | None = None
    full_rad: float = 0.0
    """For a servo: the joint's angle at the longest pulse. 0: the bridge takes duties."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeConfig:
    outputs_fd: int
    inputs_fd: int
    low_inputs: int
    """Bits of the inputs that are active when they are low."""
    event_fd: int
    priority: int
    cpu: tuple[int, ...]
    period_s: float
    setpoint_timeout_s: float
    stopping_s: float
    epoch: int
    joints: Sequence[BridgeJoint]
    pins: Sequence[Pin]


@dataclass(frozen=True, slots=True)
class BridgeReport:
    running: bool = False
    armed: bool = False
    stopping: bool = False
    fault_reasons: FaultReason = _NEVER
    number: int = 0
    error: int = 0
    error_output: int = -1
    rest_error: int = 0
    """errno of the newest failure to set a pin to its level without power; 0: all pins rest."""
    rest_output: int = -1
    active_inputs: int = 0
    cycles: int = 0
    late_cycles: int = 0
    writes: int = 0
    encoder_illegal: int = 0
    """Number of pulses that were too short to be distinguished."""
    encoder_lost: int = 0
    """Number of edges that the kernel could not keep."""


class BridgeThread:
    """The thread of one line. `start` may be called again after `stop`."""

    def __init__(self, line: int, exchange: Exchange) -> None:
        self._line = line
        self._exchange = exchange
        self._report = ffi.new("bridge_report *")
        self._number = 0

    def start(self, config: BridgeConfig) -> None:
        """Start the thread. Raise HalError if it does not start."""
        self._number = 0
        code = lib.pwm_line_start(self._line, _config(config, self._exchange))
        if code < 0:
            raise HalError(f"the thread of the bridges did not start: {os.strerror(-code)}")

    def stop(self) -> None:
        """End the thread; the pins then rest. Do nothing if it does not run."""
        lib.pwm_line_stop(self._line)

    def request_mode(self, request: BridgeMode) -> int:
        """Request a mode; return the number that the report shows once it is in force."""
        self._number += 1
        lib.pwm_line_put_control(
            self._line, ffi.new("bridge_control *", {"mode": int(request), "number": self._number})
        )
        return self._number

    def report_count(self, joint: int, count: int, stamp_ns: int, origin: int) -> None:
        """Pass the count that a board reports for a joint (EncoderKind.REPORTED). `joint` is its
        index in `BridgeConfig.joints`; `origin` changes with each restart of the board."""
        sample = {"count": count, "stamp_ns": stamp_ns, "origin": origin}
        lib.pwm_line_put_sample(self._line, joint, ffi.new("encoder_sample *", sample))

    def report(self) -> BridgeReport:
        raw = self._report
        if lib.pwm_line_read_report(self._line, raw) < 0:
            return BridgeReport()
        return value_of(BridgeReport, raw)


def _config(config: BridgeConfig, exchange: Exchange) -> Any:
    raw = ffi.new("bridge_config *")
    raw.exchange = exchange.handle
    raw.outputs_fd, raw.inputs_fd = config.outputs_fd, config.inputs_fd
    raw.low_inputs = config.low_inputs
    raw.event_fd, raw.priority = config.event_fd, config.priority
    raw.cpu_mask = sum(1 << cpu for cpu in config.cpu)
    raw.period_ns = round(config.period_s * 1e9)
    raw.setpoint_timeout_ns = round(config.setpoint_timeout_s * 1e9)
    raw.stopping_ns = round(config.stopping_s * 1e9)
    raw.epoch = config.epoch
    raw.joint_count, raw.output_count = len(config.joints), len(config.pins)
    if len(config.joints) > len(raw.joint) or len(config.pins) > len(raw.output):
        raise HalError(f"{len(config.joints)} joints and {len(config.pins)} pins are too many")
    for place, joint in zip(raw.joint, config.joints, strict=False):
        place.index = joint.index
        place.rest_mode = lib.BRIDGE_BRAKE if joint.brakes_at_rest else lib.BRIDGE_COAST
        place.sign = -1.0 if joint.inverted else 1.0
        place.fault_mask = joint.fault_mask
        place.full_rad = joint.full_rad
        if joint.encoder is not None:
            place.encoder = dataclasses.asdict(joint.encoder)
    for place, pin in zip(raw.output, config.pins, strict=False):
        place.joint, place.fd, place.bit = pin.joint, pin.fd, pin.bit
        place.inverted, place.period_ns, place.pumps = pin.inverted, pin.period_ns, pin.pumps
        for number, mode in enumerate(MODES):
            place.base[number], place.slope[number] = pin.levels[mode]
    return raw
