# SPDX-License-Identifier: Apache-2.0
"""Procedures that take time because drives and wheels do: arm, disarm, stop, reset, shutdown.

Each succeeds or leaves the robot with no more power than it had; `Refused` gives the reason. One
runs at a time, except stop and the emergency stop, which wait for no other."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator

from motord.control.machine import Event, State
from motord.control.operation import Operation
from motord.local_socket.server import Refused
from motord_hal.base.clock import now_ns, within
from motord_hal.base.errors import HalError
from motord_hal.base.tasks import TaskGroup
from motord_hal.fieldbus.ports import DriveState, Line, LineState

LINES_WITHIN_S = 4.0
"""Deadline for all drives of a line to arm, to disarm, or to clear their faults."""
CORE_WITHIN_S = 1.0
"""Deadline for the core to follow; the slowest loop ticks every 0.1 s, a line's feedback may take
longer."""
RAMP_MARGIN_S = 1.0
RAMP_MAX_S = 20.0
SHUTDOWN_RAMP_MAX_S = 8.0

_log = logging.getLogger(__name__)


async def arm(operation: Operation) -> State:
    """Enable every drive at zero speed, verify that, then arm the core. If any of it fails, take
    the power off all drives and raise Refused."""
    if operation.check(Event.ARM) is operation.state:
        return operation.state
    async with _alone(operation):
        try:
            operation.check(Event.ARM)
            for line in operation.lines:
                async with within(LINES_WITHIN_S):
                    await line.arm()
            operation.check(Event.ARM)
            await _arm_core(operation)
            return operation.take(Event.ARM)
        except (HalError, TimeoutError, Refused) as error:
            operation.set_armed(False)
            await _power_off(operation)
            raise Refused(f"not armed: {str(error) or 'a drive took too long'}") from error


async def _arm_core(operation: Operation) -> None:
    operation.set_armed(True)
    if await operation.until(lambda: operation.snapshot.armed, CORE_WITHIN_S):
        return
    snapshot = operation.snapshot
    why = ", ".join(snapshot.faults or snapshot.reasons)
    raise Refused(f"the core did not arm within {CORE_WITHIN_S:g} s ({why})")


async def disarm(operation: Operation) -> State:
    """Ramp down, then take the power off. Raises Refused if a drive did not confirm it."""
    async with operation.busy:
        problems = await _come_down(operation, RAMP_MAX_S, force=asyncio.Event())
        await _take_in_datagram(operation)
        if not problems:
            operation.acknowledge_disarm(operation.stop_requests)
    if problems:
        why = "; ".join(filter(None, (*problems, operation.rest_unknown())))
        raise Refused(f"the robot is {operation.state}, but {why}")
    return operation.state


async def disarm_on_request(operation: Operation) -> None:
    """Take the power off for each request to disarm that the loop has received, until cancelled."""
    while True:
        await operation.disarm_requested.wait()
        async with operation.busy:
            requests = operation.stop_requests
            if not operation.disarm_requested.is_set():
                continue  # the disarm that was in progress has done it
            problems = await _come_down(operation, RAMP_MAX_S, force=asyncio.Event())
            operation.acknowledge_disarm(requests)
        if problems:
            _log.warning("disarm: the robot is %s, but %s", operation.state, "; ".join(problems))


async def stop(operation: Operation) -> State:
    """Bring the robot to rest, and keep it armed. Returns when it rests; raises Refused if it does
    not."""
    operation.take(Event.STOP)
    deadline_s = ramp_s(operation, RAMP_MAX_S)
    await _take_in_datagram(operation)
    if not await operation.until(lambda: operation.state is not State.STOPPING, deadline_s):
        why = operation.rest_unknown() or "motord disarm, or motord estop"
        raise Refused(f"not seen at rest after {deadline_s:.1f} s: {why}")
    return operation.state


async def estop(operation: Operation, pid: int, why: str) -> State:
    """Stop at once; return when the core has latched the emergency stop. `pid`: the process that
    requests it; `why`: its reason, which may be empty."""
    operation.estop(pid, why)
    if not await operation.until(lambda: "estop" in operation.snapshot.faults, CORE_WITHIN_S):
        raise Refused("the loop has not confirmed the emergency stop: cut the power by hand")
    await _take_in_datagram(operation)
    return operation.state


async def _take_in_datagram(operation: Operation) -> None:
    """Wait for the loop's next tick, and follow its requests. Clients send a stop to the loop first
    (motord.api.stop_request), then to asyncio: so the loop's copy takes no effect after the
    answer."""
    asked_ns = now_ns()
    await operation.until(lambda: operation.snapshot.stamp_ns > asked_ns, CORE_WITHIN_S)
    operation.look()


async def reset(operation: Operation) -> State:
    """Clear what is latched, in the drives and in the core, if its causes are gone."""
    operation.check(Event.RESET)
    async with _alone(operation):
        operation.check(Event.RESET)
        estops = operation.estops
        try:
            for line in operation.lines:
                async with within(LINES_WITHIN_S):
                    await line.clear_faults()
        except (HalError, TimeoutError) as error:
            raise Refused(f"not reset: {str(error) or 'a drive took too long'}") from error
        await operation.until(lambda: not operation.facts().drive_faults, CORE_WITHIN_S)
        if left := operation.facts().drive_faults:
            raise Refused(f"not reset, still there: {'; '.join(left)}")
        operation.check(Event.RESET)
        _no_other_estop(operation, estops)
        operation.ask_reset()
        if not await operation.until(lambda: not operation.snapshot.faults, CORE_WITHIN_S):
            left = operation.snapshot.faults
            raise Refused(f"not reset, the cause is still there: {', '.join(left)}")
        _no_other_estop(operation, estops)
        state = operation.take(Event.RESET)
        operation.why = ()
        return state


def _no_other_estop(operation: Operation, estops: int) -> None:
    """Raise Refused if an emergency stop came during the reset: it has to stay latched."""
    if operation.estops != estops:
        raise Refused("not reset: an emergency stop came meanwhile")


async def reset_odometry(operation: Operation) -> State:
    """Set the pose to the origin; return when it is there."""
    epoch = operation.snapshot.odometry_epoch
    operation.ask_odometry_reset()
    if not await operation.until(lambda: operation.snapshot.odometry_epoch != epoch, CORE_WITHIN_S):
        raise Refused("the loop has not reset the odometry")
    return operation.state


async def shut_down(operation: Operation, force: asyncio.Event) -> list[str]:
    """Bring the robot to rest, take the power off, and show OFF on the state page. Returns texts on
    power-offs that are not confirmed. `force` leaves the ramp out: then the lines brake as they
    end. Before the call, cancel a procedure that is in progress."""
    async with operation.busy:
        problems = await _come_down(operation, SHUTDOWN_RAMP_MAX_S, force)
    for problem in problems:
        _log.warning("at the end: %s", problem)
    operation.take(Event.SHUTDOWN)
    off = State.OFF.number
    await operation.until(lambda: operation.snapshot.machine_state == off, CORE_WITHIN_S)
    return problems


@contextlib.asynccontextmanager
async def _alone(operation: Operation) -> AsyncIterator[None]:
    if operation.busy.locked():
        raise Refused("something else is running (arm, disarm or reset): try again")
    async with operation.busy:
        yield


async def _come_down(operation: Operation, ramp_max_s: float, force: asyncio.Event) -> list[str]:
    """Ramp down, disarm the core, then the drives. Returns texts on what went wrong; the state is
    right in any case."""
    operation.disarming = True
    try:
        operation.take(Event.DISARM)
        deadline_s = ramp_s(operation, ramp_max_s)
        rests = await operation.until(
            lambda: operation.snapshot.at_rest or not operation.snapshot.enabled or force.is_set(),
            deadline_s,
        )
        if force.is_set():
            return _out_of_reach(operation)
        if not rests:
            why = operation.rest_unknown() or "the wheels turn"
            _log.warning("not at rest after %.1f s: the power goes off anyway: %s", deadline_s, why)
        operation.set_armed(False)
        await operation.until(lambda: not operation.snapshot.armed, CORE_WITHIN_S)
        problems = await _power_off(operation)
        operation.take(Event.DISARMED)
        return problems
    finally:
        operation.disarming = False


def ramp_s(operation: Operation, most_s: float) -> float:
    """Return the time within which a robot that brakes as it should is at rest: v / deceleration,
    twice deceleration / jerk for both ends of the ramp, and a margin for the wheels to follow."""
    snapshot, limits = operation.snapshot, operation.in_force.limits
    if operation.in_force.joint_limits:
        rows = zip(operation.in_force.joint_limits.values(), snapshot.joints, strict=True)
        slowest_s = max(own.ramp_s(joint.setpoint_rad_s) for own, joint in rows)
        return min(slowest_s + RAMP_MARGIN_S, most_s)
    brakes_s = max(
        abs(snapshot.setpoint_linear_m_s) / limits.linear_deceleration_m_s2,
        abs(snapshot.setpoint_angular_rad_s) / limits.angular_deceleration_rad_s2,
        abs(snapshot.setpoint_lateral_m_s) / limits.lateral_deceleration_m_s2,
    )
    # one axis may bound the deceleration and the other one the jerk
    eases_s = max(
        limits.linear_deceleration_m_s2 / limits.linear_m_s3,
        limits.angular_deceleration_rad_s2 / limits.angular_rad_s3,
        limits.lateral_deceleration_m_s2 / limits.lateral_m_s3,
    )
    return min(brakes_s + 2.0 * eases_s + RAMP_MARGIN_S, most_s)


def _out_of_reach(operation: Operation) -> list[str]:
    """Return a text for each line and drive that gets no power-off as the lines end. The lines
    report those that do not confirm it."""
    closed = [line.spec for line in operation.lines if line.state is LineState.CLOSED]
    return [f"{spec.name} is not open on {spec.port}" for spec in closed] + [
        f"{joint} does not answer"
        for line in operation.lines
        if line.spec not in closed
        for joint, drive in line.drive_states.items()
        if drive is DriveState.UNRESPONSIVE
    ]


async def _power_off(operation: Operation) -> list[str]:
    """Disarm all lines at once. Returns texts on what went wrong."""
    problems: list[str] = []
    async with TaskGroup() as tasks:
        for line in operation.lines:
            tasks.create_task(_disarm_line(line, problems))
    return problems


async def _disarm_line(line: Line, problems: list[str]) -> None:
    try:
        async with within(LINES_WITHIN_S):
            await line.disarm()
    except (HalError, TimeoutError) as error:
        watched = all(joint.profile.watchdog is not None for joint in line.spec.joints)
        then = (
            "its drives should stop by their own watchdogs once nothing reaches them"
            if watched
            else "a drive of it has no watchdog and may still turn: cut its power"
        )
        problems.append(
            f"{line.spec.name} could not be disarmed ({str(error) or 'it took too long'}): {then}"
        )
