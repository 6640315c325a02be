# SPDX-License-Identifier: Apache-2.0
"""Select the class for a line by its kind and engine."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from types import MappingProxyType
from typing import cast

from motord_hal.base.errors import HalError, ProfileError
from motord_hal.fieldbus.ports import Line, LineSpec, Listener
from motord_hal.realtime.exchange import Exchange

# Strings, not classes: only the modules of a robot's own lines are imported.
KINDS = MappingProxyType(
    {
        ("modbus-rtu", "asyncio"): "motord_hal.modbus.line:ModbusRtuLine",
        ("modbus-tcp", "asyncio"): "motord_hal.modbus.tcp_line:GatewayLine",
        ("rtu-over-tcp", "asyncio"): "motord_hal.modbus.tcp_line:GatewayLine",
        ("can", "asyncio"): "motord_hal.can.line:CanLine",
        ("modbus-rtu", "rt"): "motord_hal.rt_engine.rs485.line:RtLine",
        ("pwm", "rt"): "motord_hal.pwm.line:PwmLine",
        ("ddsm", "rt"): "motord_hal.rt_engine.rs485.line:RtLine",
        ("can", "rt"): "motord_hal.rt_engine.can.line:RtCanLine",
        ("mcu", "rt"): "motord_hal.rt_engine.boards.line:RtBoardLine",
        ("roboclaw", "rt"): "motord_hal.rt_engine.rs485.line:RtLine",
        ("feetech", "rt"): "motord_hal.rt_engine.rs485.line:RtLine",
        ("dynamixel", "rt"): "motord_hal.rt_engine.rs485.line:RtLine",
        ("ascii", "rt"): "motord_hal.rt_engine.boards.line:RtBoardLine",
        ("hoverboard", "rt"): "motord_hal.rt_engine.boards.line:RtBoardLine",
        ("sabertooth", "rt"): "motord_hal.rt_engine.boards.line:RtBoardLine",
    }
)

RT_CAN_INTERFACES = ("socketcan", "unix")
"""CAN interfaces that the engine "rt" can use; python-can alone has the others."""


def engine_of(spec: LineSpec) -> str:
    """Return "rt" or "asyncio" for `spec.engine`. "auto" means rt if there is one for the kind, for
    CAN only on an interface of RT_CAN_INTERFACES."""
    if spec.engine != "auto":
        return spec.engine
    if spec.kind == "can" and spec.port.partition(":")[0] not in RT_CAN_INTERFACES:
        return "asyncio"
    return "rt" if (spec.kind, "rt") in KINDS else "asyncio"


def open_line(spec: LineSpec, exchange: Exchange, listener: Listener) -> Line:
    """Make the line for a spec; its `run()` opens the medium. Raise HalError for an unknown kind or
    engine, and ProfileError for joints that cannot be on this line."""
    engine = engine_of(spec)
    if spec.kind == "can" and engine == "rt" and engine_of(replace(spec, engine="auto")) != "rt":
        raise HalError(f'{spec.name}: engine "rt" needs SocketCAN, not {spec.port}')
    place = KINDS.get((spec.kind, engine))
    if place is None:
        engines = [known for kind, known in KINDS if kind == spec.kind]
        if engines:
            raise HalError(f'{spec.name}: no engine "{engine}" for {spec.kind}: {engines[0]} only')
        kinds = ", ".join(dict.fromkeys(kind for kind, _ in KINDS))
        raise HalError(f'{spec.name}: no line kind "{spec.kind}"; known: {kinds}')
    for joint in spec.joints:
        if engine == "asyncio" and joint.profile.goes_to_positions:
            text = f"{joint.name}: positions are carried by the engine rt alone, on a serial port"
            raise ProfileError(f"{text} or SocketCAN of this machine")
    module, _, name = place.partition(":")
    return cast("Line", getattr(import_module(module), name)(spec, exchange, listener))
