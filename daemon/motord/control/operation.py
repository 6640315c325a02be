# SPDX-License-Identifier: Apache-2.0
"""The robot in operation: what the daemon knows, and everything it can do without waiting.

One object brings machine, leases, core and lines together; its methods run in the daemon's one
asyncio thread and return at once, but for `drive`, which waits for the loop's answer. What has to
wait for drives or wheels is in `procedures.py`.

The core's levels are derived from the state each time (`put_control`), so that no level can be
forgotten."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any

from motord.api.commands import LeaseGrant
from motord.api.snapshot import Rest, Snapshot, joints_of, rest_report, rest_text
from motord.base.log import about, printable, process_name
from motord.base.rate_limited_log import LINES_AT_ONCE, LimitedLines, RateLimitedLog
from motord.base.sdnotify import Notifier
from motord.config import Limits, Robot
from motord.config.sections.joint.limits import JointLimits
from motord.config.sections.joint.speed_loop import SpeedLoop
from motord.control.battery import BatteryLevel, BatteryWatch
from motord.control.explained import COARSE_COUNTER, explained
from motord.control.in_force import InForce
from motord.control.joint_names import JointNames
from motord.control.leases import Lease, Leases, NoLease
from motord.control.machine import Event, Facts, Refusal, State, step
from motord.control.waiting import Waiting
from motord.local_socket.peer_process import Process
from motord.local_socket.server import Refused
from motord.realtime.loop import Control, Loop
from motord.realtime.types import StopRequests
from motord_hal.base.clock import within
from motord_hal.fieldbus.ports import DriveState, EventKind, Line, LineEvent, LineState
from motord_hal.realtime.exchange import now_ns

_log = logging.getLogger(__name__)

_WORRYING = {
    EventKind.LINE_LOST,
    EventKind.DRIVE_UNRESPONSIVE,
    EventKind.DRIVE_FAULT,
    EventKind.DRIVE_WARNING,
    EventKind.DRIVE_LEFT_ON,
}
_MAY_MOVE = (State.ARMED, State.MOVING)
_ESTOP_INPUTS = {
    "active": "the emergency stop's contact ({}) is active: release the button, or fix the wire",
    "lost": "the emergency stop's input ({}) cannot be read any more: start the daemon again",
}
_LATCHED = (State.FAULT, State.ESTOP)
_GUARDED = (Event.ARM, Event.RESET)
_BARE = "estop"
"""The core's reason without details: its state was read before the request that led to it."""


REASONS_MAX = 8
"""Reasons that are kept for one emergency stop: the first ones, and the newest."""


class Operation:
    """State, leases and levels of one robot. `lines` is filled before anything runs."""

    def __init__(self, robot: Robot, loop: Loop, notifier: Notifier) -> None:
        self.robot = robot
        self.loop = loop
        self.lines: list[Line] = []
        self.waiting = Waiting()
        self.state = State.OFF
        self.snapshot: Snapshot = loop.read_state()
        self.leases = Leases(loop)
        self.joint_names = JointNames(robot)
        self.in_force = InForce(robot)
        self.why: tuple[str, ...] = ()
        """Why the fault or the emergency stop is latched; empty if nothing is."""
        self.left_on: list[str] = []
        """Power-offs that a line could not confirm as it ended."""
        self.stops = 0
        """How often the robot was brought to rest by a stop, an emergency stop or a fault."""
        self.battery = BatteryWatch(robot.battery, now_ns()) if robot.battery else None
        """None: the battery is not measured."""
        self.busy = asyncio.Lock()
        """Held by a procedure: one runs at a time."""
        self.disarming = False
        """Whether a procedure is taking the power off: then STOPPING ends with it."""
        self._notifier = notifier
        self._armed = False
        self._release = False
        """Whether a disarm was requested: then drives that hold in a fault lose their power,
        too."""
        self._steps = LimitedLines(_log)
        self._estop_reasons = RateLimitedLog(_log, at_once=LINES_AT_ONCE)
        self._estop = False
        self.estops = 0
        """Number of emergency stops so far."""
        self._broken: str | None = None
        """Why the daemon itself raises a fault; None: it raises no fault."""
        self._reset_count = 0
        self._odometry_reset_count = 0
        self._changed = asyncio.Event()
        self.stop_requests = StopRequests()
        """Stop requests that the loop had received at the last look."""
        self._acknowledged = StopRequests()
        self._reported: set[str] = set()
        """Reasons for leaving out a part of a command that were logged: each is logged once."""
        self.disarm_requested = asyncio.Event()
        """Set from a request to disarm until `acknowledge_disarm`."""

    # ------------------------------------------------------------------------- the machine's steps
    def facts(self) -> Facts:
        """Return the facts by which the guards decide, as they are now."""
        joints = dict(zip(self.robot.joint, self.snapshot.joints, strict=True))
        words = {name: found for line in self.lines for name, found in line.drive_faults.items()}
        return Facts(
            unready_lines=tuple(self._unready()),
            stale_joints=tuple(name for name, joint in joints.items() if joint.stale),
            lost_positions=self._lost_positions(),
            drive_faults=tuple(
                f"{name}: {', '.join(words.get(name) or ['fault'])}"
                for name, joint in joints.items()
                if joint.drive_faults
            ),
            commanding=self.leases.wanting(),
            rest=self.snapshot.rest,
            estop_input=self.estop_input(),
            battery_forbids=self.battery_forbids,
        )

    def _lost_positions(self) -> tuple[str, ...]:
        lost = self.snapshot.position_unknown
        return tuple(name for place, name in enumerate(self.robot.joint) if lost >> place & 1)

    def estop_input(self) -> str:
        """Return why the emergency stop's contact stops the robot now; empty: it does not."""
        pin = self.robot.safety.estop
        found = self.loop.status().estop_input if pin is not None else ""
        if pin is None or found not in _ESTOP_INPUTS:
            return ""
        return _ESTOP_INPUTS[found].format(f"{pin.gpio_line} of {pin.gpio_chip}")

    @property
    def battery_forbids(self) -> bool:
        """Whether the battery is critical and the robot file stops the robot for that."""
        stops = self.robot.safety.on_battery_critical == "stop"
        return stops and self.battery is not None and self.battery.level is BatteryLevel.CRITICAL

    def check(self, event: Event) -> State:
        """Return the state to which the event would lead. Raises Refused."""
        target = step(self.state, event, self.facts() if event in _GUARDED else Facts())
        if isinstance(target, Refusal):
            raise Refused(target.reason)
        return target

    def take(self, event: Event) -> State:
        """Take the step, and inform the core and the supervisor. Raises Refused."""
        target = self.check(event)
        if target is self.state:
            return target
        self._steps.say(f"{target} ({event}, was {self.state})")
        if target in _LATCHED or event is Event.STOP:
            self.stops += 1
        self.state = target
        self.leases.follow(may_move=target in _MAY_MOVE, armed=event is Event.ARM)
        self.put_control()
        self._notifier.status(target)
        self._notify()
        return target

    def _unready(self) -> list[str]:
        return [
            f"line {line.spec.name} is {line.state}"
            for line in self.lines
            if line.state is not LineState.READY
        ] + [
            f"{joint} is {drive}"
            for line in self.lines
            if line.state is LineState.READY
            for joint, drive in line.drive_states.items()
            if drive not in (DriveState.READY, DriveState.ARMED)
        ]

    # ------------------------------------------------------------------------- what the core gets
    def put_control(self) -> None:
        """Give the core all levels as they follow from the state, and a heartbeat."""
        self.loop.put_control(
            Control(
                armed=self._armed,
                stop=self.state is State.STOPPING,
                estop=self._estop,
                fault=self._broken is not None,
                release=self._release,
                reset_count=self._reset_count,
                odometry_reset_count=self._odometry_reset_count,
                machine_state=self.state.number,
                **self.in_force.levels(),
            )
        )

    def set_armed(self, armed: bool) -> None:
        """Set the level by which the core arms or disarms."""
        self._armed = armed
        self._release = not armed
        self.put_control()

    def ask_reset(self) -> None:
        """Drop the fault reasons of the daemon itself, and request the core to clear its own."""
        self._estop = False
        self._broken = None
        self._armed = False
        self._reset_count += 1
        self.put_control()

    def ask_odometry_reset(self) -> None:
        """Request the core to set the pose to the origin at the next tick."""
        self._odometry_reset_count += 1
        self.put_control()

    def set_limits(self, limits: Limits) -> None:
        """Put limits in force from the next tick on. They have been checked."""
        self.in_force.limits = limits
        self.put_control()

    def set_joint_limits(self, limits: Mapping[str, JointLimits]) -> None:
        """Put limits of joints in force from the next tick on. They have been checked."""
        self.in_force.change_joint_limits(limits)
        self.put_control()

    def set_speed_loops(self, loops: Mapping[str, SpeedLoop]) -> None:
        """Put gains in force from the next tick on, without a step of the output. They have been
        checked."""
        self.in_force.change_speed_loops(loops)
        self.put_control()

    # ---------------------------------------------------------------------------------- commanding
    async def drive(
        self,
        connection: int,
        owner: str,
        priority: int,
        lease_s: float,
        linear_m_s: float,
        angular_rad_s: float,
        lateral_m_s: float = 0.0,
        process: Process | None = None,
    ) -> Lease:
        """Hand a command to the loop. Raises Refused if the command will move nothing, ValueError
        for a number out of bounds."""
        return await self.obeyed(
            self.leases.submit(
                owner=owner,
                connection=connection,
                priority=priority,
                lease_s=lease_s,
                process=process,
                linear_m_s=linear_m_s,
                angular_rad_s=angular_rad_s,
                lateral_m_s=lateral_m_s,
            ),
        )

    async def obeyed(self, submitting: Awaitable[Lease]) -> Lease:
        """Wait until a command is handed to the loop, and return its lease. Raises as `drive`."""
        try:
            lease = await submitting
        except NoLease as error:
            raise Refused(str(error)) from error
        if self.state not in _MAY_MOVE and lease.wants_motion:
            how = "wait until it is at rest" if self.state is State.STOPPING else "motord arm"
            if self.state in _LATCHED:
                how = "motord reset, then motord arm"
            raise Refused(f"the state is {self.state}, so the robot does not move: {how}")
        if lease.held:
            raise Refused(lease.why_held)
        return lease

    def lease(
        self,
        connection: int,
        owner: str,
        priority: int,
        lease_s: float,
        rate_max_hz: float | None = None,
        process: Process | None = None,
    ) -> LeaseGrant:
        """Return a lease for the loop's sockets: see `Leases.grant`. Raises Refused, ValueError."""
        try:
            return self.leases.grant(
                connection, owner, priority, lease_s, kept=True,
                rate_max_hz=rate_max_hz, process=process,
            )  # fmt: skip
        except NoLease as error:
            raise Refused(str(error)) from error

    def release(self, connection: int, owner: str) -> None:
        """End the owner's lease."""
        self.leases.release(connection, owner)

    def disconnect(self, connection: int) -> None:
        """End all leases of a connection."""
        self.leases.disconnect(connection)

    # ---------------------------------------------------------------------------- what is reported
    def estop(self, pid: int, why: str = "") -> None:
        """Latch an emergency stop at once, from every state. `pid`: the process that requests it;
        `why`: its reason as a text, which may be empty."""
        self._estop = True
        self.estops += 1
        sender = process_name(pid)
        anonymous = f"requested by {sender}"
        reason = f"{printable(why)} ({sender})" if why else anonymous
        before = self.why if self.state is State.ESTOP else ()
        known = reason in before or any(sender in one for one in before if not why)
        if not known:
            kept = [one for one in before if one not in (anonymous, _BARE)]
            self.why = (*kept[: REASONS_MAX - 1], reason)
            self._estop_reasons.say(f"emergency stop: {reason}")
        self.take(Event.ESTOP)
        self.put_control()

    def fault(self, why: str) -> None:
        """Raise a fault for a cause that the core cannot see. Without power on the drives, do
        nothing."""
        self.look()
        if not self.state.live:  # there is no power to take off, or the core has seen it already
            return
        self._broken = why
        self._latch(Event.FAULT, [why])
        self.put_control()

    def _latch(self, event: Event, why: list[str]) -> None:
        if self.state not in _LATCHED:
            self.why = tuple(why)
            _log.warning("fault: %s", "; ".join(why), extra=about(event="fault", faults=why))
        self.take(event)

    def _follow_stop_requests(self) -> None:
        """Let the state follow the stop requests, as the loop does already. A request is
        acknowledged only when the levels of this object hold it, so that nothing moves or arms in
        between."""
        now, before = self.loop.stop_requests(), self.stop_requests
        if now == before or self.state is State.OFF:
            return
        self.stop_requests = now
        if now.estop != before.estop:
            self.estop(now.pid)
        if now.stop != before.stop:
            self.take(Event.STOP)
        if now.disarm != before.disarm:
            self.disarm_requested.set()
        self._acknowledge(replace(now, disarm=self._acknowledged.disarm))

    def acknowledge_disarm(self, requests: StopRequests) -> None:
        """Acknowledge the requests to disarm up to this one: the power is off."""
        self._acknowledge(replace(self._acknowledged, disarm=requests.disarm))
        if requests.disarm == self.stop_requests.disarm:
            self.disarm_requested.clear()

    def _acknowledge(self, requests: StopRequests) -> None:
        self._acknowledged = requests
        self.put_control()
        self.loop.acknowledge_stops(requests)

    def look(self) -> None:
        """Follow the core's newest state and the loop's stop requests. This never arms the
        robot."""
        self._follow_stop_requests()
        try:
            before, self.snapshot = self.snapshot, self.loop.read_state()
        except BlockingIOError:  # the loop wrote during every try: the next look comes soon
            return
        snapshot = self.snapshot
        if snapshot.rest == Rest.UNKNOWN != before.rest:
            _log.warning("%s", self.rest_unknown(), extra=about(event="rest_unknown"))
        if coarse := snapshot.counter_coarse & ~before.counter_coarse:
            names = ", ".join(joints_of(coarse, list(self.robot.joint)))
            _log.warning(COARSE_COUNTER, names, extra=about(event="counter_coarse"))
        self._report_once(
            "lateral_impossible",
            "a command asks this base to move sideways (%g m/s), which it cannot: that part "
            "counts as zero, here and from now on (commands.sideways of status counts them)",
            snapshot.wanted_lateral_m_s,
        )
        self._report_once(
            "turn_impossible",
            "a command asks this base to turn on the spot (%g rad/s), which its steering cannot: "
            "that counts as zero, here and from now on (commands.on_spot of status counts them)",
            snapshot.wanted_angular_rad_s,
        )
        if snapshot.faults:
            estop = "estop" in snapshot.faults
            self.estops += estop and "estop" not in before.faults
            why = explained(snapshot, self.facts(), self.robot, self._broken)
            self._latch(Event.ESTOP if estop else Event.FAULT, why)
            self._armed = False  # the core arms next at a new rising edge of this level
        elif self.disarm_requested.is_set() and not snapshot.armed:
            pass  # the loop has disarmed as requested; DISARMED follows when the power is off
        elif self.state.live and self._armed and not snapshot.armed:
            _log.warning("the core has disarmed by itself: %s", ", ".join(snapshot.reasons))
            self._armed = False
            self.take(Event.DISARMED)
        elif snapshot.rest != Rest.AT_REST:
            self.take(Event.MOVED)
        elif self.state is State.STOPPING and not self.disarming:
            if "stop_requested" in snapshot.reasons:  # else the loop has not seen the stop yet
                self.take(Event.STOPPED)
        else:
            self.take(Event.RESTED)
        self._notify()

    def rest_report(self) -> dict[str, Any]:
        """Return whether the robot rests, with the names of the joints: see api.snapshot."""
        return rest_report(self.snapshot, tuple(self.robot.joint))

    def rest_unknown(self) -> str:
        """Return a warning while it is unknown whether the robot rests; empty: it is known."""
        if self.snapshot.rest != Rest.UNKNOWN:
            return ""
        return rest_text(self.snapshot.rest, self.rest_report()["rest_unknown_s"])

    def _report_once(self, reason: str, text: str, speed: float) -> None:
        if reason in self.snapshot.reasons and reason not in self._reported:
            self._reported.add(reason)
            _log.warning(text, speed)

    def on_line_event(self, event: LineEvent) -> None:
        """Log an event, which a line reports once. A loss under power is a fault."""
        level = logging.WARNING if event.kind in _WORRYING else logging.INFO
        details = about(line=event.line, joints=event.joints, event=event.kind)
        _log.log(level, "%s", event.text, extra=details)
        self.waiting.note(event)
        if event.kind is EventKind.DRIVE_LEFT_ON:
            self.left_on.append(event.text)
        if event.kind in (EventKind.LINE_LOST, EventKind.DRIVE_UNRESPONSIVE):
            self.fault(event.text)
        elif event.kind is EventKind.DRIVE_FAULT and self.state is State.FAULT:
            self._name_also(event.text)

    def _name_also(self, why: str) -> None:
        """Add a reason to the fault: a drive that switches itself off may report it only later."""
        if why not in self.why:
            self.why = (*self.why, why)
            _log.warning("fault: %s", why, extra=about(event="fault", faults=[why]))

    def beat(self) -> None:
        """Check what no event reports, and give the core a heartbeat."""
        self.look()
        if self._unready():
            self.take(Event.LOST)
        elif not any(joint.stale for joint in self.snapshot.joints):
            self.take(Event.READY)
        if self.state.live and not (self.disarming or self.disarm_requested.is_set()):
            self._cross_check()
        self.put_control()

    def _cross_check(self) -> None:
        """Raise a fault unless every drive is armed, as it has to be under power."""
        unarmed = self._unready() or [
            f"{joint} is not armed any more"
            for line in self.lines
            for joint, drive in line.drive_states.items()
            if drive is not DriveState.ARMED
        ]
        if unarmed:
            self.fault("; ".join(unarmed))

    # ------------------------------------------------------------------------------------- waiting
    def _notify(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def until(self, condition: Callable[[], bool], deadline_s: float) -> bool:
        """Wait until the condition holds, and return whether it did within the deadline. It is
        looked at with each snapshot and each step."""
        try:
            async with within(deadline_s):
                while not condition():
                    await self._changed.wait()
        except TimeoutError:
            return False
        return True
