# SPDX-License-Identifier: Apache-2.0
"""Registers of the drives by name, as their profiles call them: `drive.left.bus_voltage`, in SI.

They are read and written while the lines cycle, one at a time. What is written is not stored in the
drive: it lasts until the drive loses its power.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from motord.control.machine import State
from motord.control.operation import Operation
from motord.local_socket.server import INVALID_PARAMS, Refused, RpcError, json_number
from motord_hal.base.clock import within
from motord_hal.base.errors import HalError
from motord_hal.base.nearest import nearest
from motord_hal.drives.profile import SI_UNITS, Register
from motord_hal.fieldbus.parameter import kept_back
from motord_hal.fieldbus.ports import JointSpec, Line

PREFIX = "drive."
WITHIN_S = 4.0
"""Deadline for one register to be read or written."""


def listed(lines: Iterable[Line]) -> dict[str, dict[str, Any]]:
    """Return unit, range, access and source of every register that can be read. The value of
    each is missing (None), because the drive is not read."""
    return {
        f"{PREFIX}{joint.name}.{register.name}": _about(joint, register)
        for _, joint in _joints(lines)
        for register in joint.profile.registers.values()
        if "r" in register.access
    }


def _about(joint: JointSpec, register: Register) -> dict[str, Any]:
    low, high = register.si_limits
    writable = "w" in register.access and register.name not in kept_back(joint.profile)
    return {
        "value": None,
        "unit": SI_UNITS[register.unit][0] or "1",
        "minimum": low,
        "maximum": high,
        "access": "rw" if writable else "r",
        "description": f"{joint.profile.name}: {register.source}",
    }


async def values(lines: Iterable[Line], names: Iterable[str]) -> dict[str, float | None]:
    """Return the values by name, as the drives report them now; None: not a number. Raises
    RpcError."""
    found = {name: _place(lines, name) for name in names}
    return {name: json_number(await _read(*place)) for name, place in found.items()}


async def write(operation: Operation, wanted: Mapping[str, Any]) -> dict[str, float | None]:
    """Write registers one after the other, read each back, and return the values in force. This
    works only without power, which cannot come on meanwhile. Raises RpcError: the registers before
    the failed one have been written."""
    found = {name: _place(operation.lines, name) for name in wanted}
    if not found:
        return {}
    for name, value in wanted.items():
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise RpcError(f"{name}: {value!r} is not a number", INVALID_PARAMS)
    if operation.busy.locked():
        raise Refused("something else is running (arm, disarm or reset): try again")
    async with operation.busy:
        done: dict[str, float | None] = {}
        for name, place in found.items():
            if operation.state is not State.IDLE:
                raise Refused(f"{name}: a drive is set up without power only: motord disarm first")
            done[name] = json_number(await _write(*place, float(wanted[name])))
        return done


def _joints(lines: Iterable[Line]) -> Iterator[tuple[Line, JointSpec]]:
    for line in lines:
        for joint in line.spec.joints:
            yield line, joint


def _place(lines: Iterable[Line], name: str) -> tuple[Line, str, str]:
    """Return line, joint and register of a name. Raises RpcError for an unknown name."""
    joint_name, _, register = name.removeprefix(PREFIX).partition(".")
    known = []
    for line, joint in _joints(lines):
        if joint.name == joint_name and register in joint.profile.registers:
            return line, joint_name, register
        known += [f"{PREFIX}{joint.name}.{one}" for one in joint.profile.registers]
    near = nearest(name, known)
    hint = f"did you mean {near}?" if near else "params.list names them all"
    raise RpcError(f"no parameter {name!r}: {hint}", INVALID_PARAMS)


async def _read(line: Line, joint: str, register: str) -> float:
    try:
        async with within(WITHIN_S):
            return await line.read_register(joint, register)
    except LookupError as error:
        raise RpcError(str(error.args[0]), INVALID_PARAMS) from error
    except (HalError, TimeoutError) as error:
        raise Refused(
            f"{joint}: {register} was not read: {str(error) or 'it took too long'}"
        ) from error


async def _write(line: Line, joint: str, register: str, value: float) -> float:
    try:
        async with within(WITHIN_S):
            return await line.write_register(joint, register, value)
    except (LookupError, ValueError) as error:
        raise RpcError(str(error.args[0]), INVALID_PARAMS) from error
    except (HalError, TimeoutError) as error:
        why = str(error) or "it took too long"
        raise Refused(f"{joint}: {register} was not written: {why}") from error
