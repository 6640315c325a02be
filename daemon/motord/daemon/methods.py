# SPDX-License-Identifier: Apache-2.0
"""Methods of the local socket: the table of docs/architecture.md."""

from __future__ import annotations

import logging
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motord.api.commands import POSITIONS_VERSION
from motord.base.log import TEXT_CHARS_MAX
from motord.base.recent_log import RecentLog
from motord.bus.publish.snapshot_feed import SnapshotFeed
from motord.config import SocketInput
from motord.control.health import Health
from motord.control.leases import LEASE_MAX_S, LEASE_MIN_S, Lease
from motord.control.machine import State
from motord.control.operation import Operation
from motord.daemon import procedures, report
from motord.daemon.bus_supervisor import BusSupervisor
from motord.daemon.parameters import drive as drive_parameters
from motord.daemon.parameters import gain as gain_parameters
from motord.daemon.parameters import joint as joint_parameters
from motord.daemon.parameters import robot as parameters
from motord.daemon.tracing import Tracing
from motord.local_socket.command_sockets import CommandSockets
from motord.local_socket.params import Params, flag, names, number, text, values
from motord.local_socket.server import INVALID_PARAMS, Caller, Method, Refused, RpcError

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnerParams(Params):
    """Parameter for the owner of a lease."""

    owner: str = text(64, r"[\w.:/-]+", default="socket")


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaseParams(OwnerParams):
    priority: int | None = number(0, 1000, whole=True, default=None)
    lease_s: float | None = number(LEASE_MIN_S, LEASE_MAX_S, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveParams(LeaseParams):
    linear_m_s: float = number()
    angular_rad_s: float = number()
    lateral_m_s: float = number(default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointsParams(LeaseParams):
    velocity_rad_s: Mapping[str, float] | None = values()
    position_rad: Mapping[str, float] | None = values()
    clamp: bool = flag()


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmParams(Params):
    release_held: bool = flag()


@dataclass(frozen=True, slots=True, kw_only=True)
class EstopParams(Params):
    why: str = text(TEXT_CHARS_MAX, default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class NamesParams(Params):
    names: tuple[str, ...] = names()


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceParams(Params):
    line: str = text(64)
    after: int | None = number(0, 2**53, whole=True, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogParams(Params):
    after: int = number(0, 2**53, whole=True, default=0)


def methods(
    operation: Operation,
    health: Health,
    feeds: Mapping[str, SnapshotFeed],
    command_sockets: CommandSockets,
    bus: BusSupervisor | None,
    recent_log: RecentLog,
    tracing: Tracing,
) -> dict[str, Method]:
    """Return the methods by name. The first six only read."""
    return {
        "log": Method(lambda _, params: recent_log.after(params.after), LogParams, commands=False),
        "status": _looking(lambda: report.status(operation, health, feeds, bus)),
        "robot": _looking(lambda: report.description(operation)),
        "latency": _looking(lambda: report.latency(operation.loop)),
        "params.list": _looking(
            lambda: (
                parameters.listed(operation.robot, operation.in_force.limits)
                | joint_parameters.listed(operation.robot, operation.in_force.joint_limits)
                | gain_parameters.listed(operation.robot, operation.in_force.speed_loops)
                | drive_parameters.listed(operation.lines)
            )
        ),
        "params.get": Method(
            lambda _, params: _get(operation, params.names), NamesParams, commands=False
        ),
        "params.set": Method(lambda _, wanted: _set(operation, wanted), None),
        "trace": Method(lambda _, params: tracing.read(params.line, params.after), TraceParams),
        "drive": Method(lambda caller, params: _drive(operation, caller, params), DriveParams),
        "joints": Method(
            lambda caller, params: _drive_joints(operation, caller, params), JointsParams
        ),
        "lease": Method(
            lambda caller, params: _lease(operation, command_sockets, caller, params), LeaseParams
        ),
        "release": Method(lambda who, params: _release(operation, who, params), OwnerParams),
        "arm": Method(lambda _, params: _arm(operation, params), ArmParams),
        "disarm": _stopping(operation, procedures.disarm),
        "stop": _stopping(operation, procedures.stop, names_held=True),
        "estop": Method(
            lambda caller, params: _estop(operation, caller, params), EstopParams, urgent=True
        ),
        "reset": _acting(lambda _: procedures.reset(operation)),
        "reset_odometry": _acting(lambda _: procedures.reset_odometry(operation)),
    }


def _looking(look: Callable[[], Any]) -> Method:
    return Method(lambda caller, params: look(), commands=False)  # noqa: ARG005  # a Method's call


def _acting(act: Callable[[Caller], Awaitable[State]]) -> Method:
    async def call(caller: Caller, _: Params) -> dict[str, Any]:
        return {"state": (await act(caller)).value}

    return Method(call)


def _stopping(
    operation: Operation,
    act: Callable[[Operation], Awaitable[State]],
    *,
    names_held: bool = False,
) -> Method:
    """Return the method whose answer has also whether the robot rests, and, if `names_held`, which
    sources are held."""

    async def call(_: Caller, __: Params) -> dict[str, Any]:
        answer = {"state": (await act(operation)).value, **operation.rest_report()}
        return answer | ({"held": report.held(operation)} if names_held else {})

    return Method(call)


def _release_held(operation: Operation) -> tuple[str, ...]:
    owners = operation.leases.release_held()
    if owners:
        _log.warning("a person lets go on: %s", ", ".join(owners))
    return owners


async def _arm(operation: Operation, params: ArmParams) -> dict[str, Any]:
    """Arm. Where the robot is armed already, a person may let the held sources go on: arming itself
    ends no hold, since who arms has not seen yet who is held."""
    before = operation.state
    state = await procedures.arm(operation)
    released = _release_held(operation) if params.release_held and state is before else ()
    return {
        "state": state.value,
        "held": [] if released else report.held(operation),
        "released": list(released),
    }


async def _estop(operation: Operation, caller: Caller, params: EstopParams) -> dict[str, Any]:
    state = await procedures.estop(operation, caller.pid, params.why)
    return {"state": state.value, **operation.rest_report()}


def _input(operation: Operation) -> SocketInput:
    """Return the settings for commands from the local socket. Raises Refused if the robot file has
    switched them off."""
    section = operation.robot.local_input
    if not section.enabled:
        raise Refused(
            "the robot file switches off commands from the local socket: set enabled = true in its "
            '[input.*] of kind = "socket", or command by one of its other inputs (motord status)'
        )
    return section


async def _drive(operation: Operation, caller: Caller, params: DriveParams) -> dict[str, Any]:
    if operation.joint_names.without_base:
        raise Refused("this robot has no base that drives: command its joints (motord joints)")
    twist = params.linear_m_s, params.angular_rad_s, params.lateral_m_s
    lease = await operation.drive(
        caller.connection, *_source(operation, params), *twist, process=caller.process
    )
    return _in_command(operation, lease)


async def _drive_joints(
    operation: Operation, caller: Caller, params: JointsParams
) -> dict[str, Any]:
    owner, priority, lease_s = _source(operation, params)
    velocities, positions = operation.joint_names.places(
        params.velocity_rad_s or {}, params.position_rad or {}
    )
    submitting = operation.leases.submit_joints(
        owner=owner,
        connection=caller.connection,
        priority=priority,
        lease_s=lease_s,
        process=caller.process,
        joint_count=len(operation.robot.joint),
        velocity_rad_s=velocities,
        position_rad=positions,
        clamp=params.clamp,
        beyond="" if params.clamp else operation.joint_names.beyond(params.position_rad or {}),
    )
    lease = await operation.obeyed(submitting)
    return _in_command(operation, lease)


def _source(operation: Operation, params: LeaseParams) -> tuple[str, int, float]:
    """Return owner, priority and lease_s."""
    section = _input(operation)
    return (
        params.owner,
        section.priority if params.priority is None else params.priority,
        section.lease_s if params.lease_s is None else params.lease_s,
    )


def _in_command(operation: Operation, lease: Lease) -> dict[str, Any]:
    commander = operation.leases.commander()
    return {
        "owner": commander.owner if commander else None,
        "in_command": commander is not None and commander.number == lease.number,
        "number": lease.number,
    }


def _lease(
    operation: Operation, command_sockets: CommandSockets, caller: Caller, params: LeaseParams
) -> dict[str, Any]:
    """Make a lease for commands by datagrams, which lasts as long as this connection. An owner with
    the name of an input of the second process gets what that section gives."""
    section = command_sockets.inputs.get(params.owner, command_sockets.section)
    if section is None:
        raise Refused('the robot file has no [input.*] of kind = "rt": no commands as datagrams')
    priority = section.priority if params.priority is None else params.priority
    if priority > section.priority:
        raise RpcError(
            f"priority {priority} is above the robot file's {section.priority}", INVALID_PARAMS
        )
    lease_s = section.lease_s if params.lease_s is None else params.lease_s
    if params.owner in command_sockets.inputs and lease_s > section.lease_s:
        raise RpcError(
            f"lease_s {lease_s:g} is above the robot file's {section.lease_s:g}", INVALID_PARAMS
        )
    rate_max_hz = section.rate_max_hz
    # motord-bus passes on what others send, and they go on when it is started anew
    process = None if params.owner in command_sockets.inputs else caller.process
    grant = operation.lease(
        caller.connection, params.owner, priority, lease_s, rate_max_hz, process
    )
    number = operation.leases.socket_number(caller.connection, params.owner)
    return {
        "token": grant.token.hex(),
        "number": grant.number,
        "priority": priority,
        "lease_s": lease_s,
        "rate_max_hz": rate_max_hz,
        "socket": str(command_sockets.paths[number]),
        "udp_port": command_sockets.udp_port,
        "version": POSITIONS_VERSION,
    }


def _release(operation: Operation, caller: Caller, params: OwnerParams) -> dict[str, Any]:
    operation.release(caller.connection, params.owner)
    return {}


async def _get(operation: Operation, names: Sequence[str]) -> dict[str, float | None]:
    """Return values by name; without a name, all limits and gains. Drives are read only if their
    registers are named."""
    robot, loops, own = (
        operation.robot,
        operation.in_force.speed_loops,
        operation.in_force.joint_limits,
    )
    if not names:
        limits = parameters.values(operation.in_force.limits, robot.base)
        limits |= joint_parameters.values(robot, own)
        return limits | gain_parameters.values(robot, loops)
    of_drives, gains, of_joints, limit_names = _by_kind(names)
    found = (
        parameters.values(operation.in_force.limits, robot.base, limit_names) if limit_names else {}
    )
    found |= joint_parameters.values(robot, own, of_joints)
    found |= gain_parameters.values(robot, loops, gains)
    return found | await drive_parameters.values(operation.lines, of_drives)


def _by_kind(names: Sequence[str]) -> tuple[list[str], ...]:
    """Return the names of drives, of speed loops, of joints without a base, and all others."""
    kinds: tuple[list[str], ...] = ([], [], [], [])
    for name in names:
        if name.startswith(drive_parameters.PREFIX):
            kinds[0].append(name)
        elif name.startswith(gain_parameters.PREFIX):
            kinds[1 if gain_parameters.is_gain(name) else 2].append(name)
        else:
            kinds[3].append(name)
    return kinds


async def _set(operation: Operation, wanted: Mapping[str, Any]) -> dict[str, float | None]:
    """Set limits and gains, all or none; or registers of drives, one after the other. `force` among
    the values: also limits beyond those of the robot file."""
    wanted = dict(wanted)
    force = wanted.pop("force", False)
    if not isinstance(force, bool):
        raise RpcError("force is true or false", INVALID_PARAMS)
    for name, value in wanted.items():
        if isinstance(value, int) and abs(value) > sys.float_info.max:  # JSON sets no bound
            raise RpcError(f"{name}: is too large a number", INVALID_PARAMS)
    of_drives, gains, of_joints, limits = (
        {name: wanted[name] for name in names} for names in _by_kind(list(wanted))
    )
    if of_drives and len(of_drives) < len(wanted):
        raise RpcError("limits and registers of drives are set one after the other", INVALID_PARAMS)
    if of_drives:
        return dict(await drive_parameters.write(operation, of_drives))
    now, robot = operation.snapshot, operation.robot
    moving = now.setpoint_linear_m_s, now.setpoint_angular_rad_s, now.setpoint_lateral_m_s
    new_limits = parameters.changed(robot, operation.in_force.limits, limits, moving, force=force)
    new_joints = joint_parameters.changed(
        robot,
        operation.in_force.joint_limits,
        of_joints,
        [one.setpoint_rad_s for one in now.joints],
        force=force,
    )
    new_loops = gain_parameters.changed(robot, operation.in_force.speed_loops, gains)
    if force:
        _log.warning("set by force, beyond the robot file where needed: %s", wanted)
    if limits:
        operation.set_limits(new_limits)
    if new_joints:
        operation.set_joint_limits(new_joints)
    if new_loops:
        operation.set_speed_loops(new_loops)
    return await _get(operation, list(wanted)) if wanted else {}
