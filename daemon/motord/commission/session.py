# SPDX-License-Identifier: Apache-2.0
"""The time in which a procedure has the robot armed. However it ends, the robot is at rest and
disarmed afterwards."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from motord.api.halting import found_rest, halt
from motord.api.motion import Goal, Motion
from motord.api.moving import Moved, MoveFailed
from motord.api.snapshot import Rest, Snapshot
from motord.api.state_page import NoPage, StatePage
from motord.client import Client, ClientError, Refused
from motord.commission.dead_man import dead_man
from motord.commission.person import Aborted, Failed, Person

LOOK_EVERY_S = 0.02
RESTS_WITHIN_S = 20.0
"""The longest stop that a robot file can allow."""
BESIDE_MAX = 0.3
"""Greatest distance from the goal at which a motion may rest, as a part of its distance."""
ABORTED_TEXT = "aborted: the robot is at rest and disarmed, nothing was written"


@dataclass(frozen=True, slots=True)
class Held:
    """Snapshots from the start of a commanded twist until the robot was at rest."""

    snapshots: tuple[Snapshot, ...]
    faults: tuple[str, ...]
    """Faults that were latched meanwhile and have ended the motion."""


@dataclass(slots=True)
class Session:
    """An armed robot. `client` holds the lease, so the robot stops when this process ends."""

    client: Client
    person: Person
    owner: str
    page: StatePage
    robot: dict[str, Any]
    """The daemon's answer of `robot`."""
    faults: list[str] = field(default_factory=list)
    look_every_s: float = LOOK_EVERY_S

    # ------------------------------------------------------------------------------------- motions
    def hold(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        seconds: float,
        enough: Callable[[Snapshot], bool] = lambda _: False,
        *,
        lateral_m_s: float = 0.0,
    ) -> Held:
        """Command this twist for a time, or until `enough` is true, then zero until the robot is at
        rest. Raises Aborted, Failed, ClientError."""
        found: list[Snapshot] = []
        end_s = time.monotonic() + seconds
        for newest in self._looks():
            found.append(newest)
            if newest.faults:
                return self._faulty(found)
            if time.monotonic() >= end_s or enough(newest):
                break
            self._command(linear_m_s, angular_rad_s, lateral_m_s)
        end_s = time.monotonic() + RESTS_WITHIN_S
        for newest in self._looks():
            found.append(newest)
            if newest.faults:
                return self._faulty(found)
            if newest.at_rest and not any(
                (
                    newest.setpoint_linear_m_s,
                    newest.setpoint_lateral_m_s,
                    newest.setpoint_angular_rad_s,
                )
            ):
                return Held(tuple(found), ())
            if time.monotonic() > end_s:
                raise Failed(f"the robot does not come to rest within {RESTS_WITHIN_S:g} s")
            self._command(0.0, 0.0)
        raise AssertionError  # _looks has no end

    def carry_out(self, goal: Goal, watch: Callable[[Motion, Snapshot], object]) -> Moved:
        """Drive a distance or an angle by the odometry. A rest beside the goal is good enough,
        since the measured end counts. Raises Aborted, Failed, ClientError."""
        stops = self.client.status().stops
        try:
            return self.client.carry_out(
                goal, owner=self.owner, watch=watch, canceled=self.person.aborted
            )
        except MoveFailed as error:
            if self.person.aborted():
                raise Aborted(ABORTED_TEXT) from error
            newest, moved = self.newest(), error.moved
            unharmed = newest.armed and newest.at_rest and not newest.faults
            if moved is None or not unharmed or self.client.status().stops != stops:
                raise Failed(str(error)) from error
            done_u = moved.distance_m if goal.axis == "linear" else moved.angle_rad
            if abs(done_u - goal.distance_u) > BESIDE_MAX * abs(goal.distance_u):
                raise Failed(str(error)) from error
            return moved

    def newest(self) -> Snapshot:
        """Return the newest state. Raises Failed."""
        found = self.page.read()
        if found is None:
            raise Failed("the daemon writes no state page any more")
        return found

    def wait_still(self, seconds: float) -> list[Snapshot]:
        """Return the snapshots of this time, in which the robot stands. Raises Aborted, Failed."""
        found: list[Snapshot] = []
        end_s = time.monotonic() + seconds
        for newest in self._looks():
            found.append(newest)
            if time.monotonic() >= end_s:
                return found
        raise AssertionError  # _looks has no end

    def stopped_by(self, faults: tuple[str, ...]) -> str:
        """Return what has ended a motion, for an error: a fault in the daemon's words."""
        why = "; ".join(self.client.status().why) or ", ".join(faults)
        return f"the robot stopped by itself: {why}"

    def _looks(self) -> Iterator[Snapshot]:
        due_s = time.monotonic()
        last_tick, changed_s = -1, due_s
        while True:
            if self.person.aborted():
                raise Aborted(ABORTED_TEXT)
            newest = self.newest()
            if newest.tick != last_tick:
                last_tick, changed_s = newest.tick, time.monotonic()
            elif time.monotonic() - changed_s > 1.0:
                raise Failed("the daemon's loop stands still")
            yield newest
            due_s = max(due_s + self.look_every_s, time.monotonic())
            time.sleep(max(due_s - time.monotonic(), 0.0))

    def _command(self, linear_m_s: float, angular_rad_s: float, lateral_m_s: float = 0.0) -> None:
        try:
            answer = self.client.drive(linear_m_s, angular_rad_s, lateral_m_s, owner=self.owner)
        except Refused as error:
            if self.newest().faults:
                return  # the next look ends the motion
            raise Failed(f"another program has stopped the robot: {error}") from error
        if any((linear_m_s, angular_rad_s, lateral_m_s)) and not answer["in_command"]:
            raise Failed(f"{answer['owner']} is in command: end that program first")
        if not self.newest().armed and not self.newest().faults:
            raise Failed("another program has disarmed the robot")

    def _faulty(self, found: list[Snapshot]) -> Held:
        """Return what was recorded before a fault stopped the robot. Raises Failed for an
        e-stop."""
        faults = found[-1].faults
        if "estop" in faults:
            raise Failed("the emergency stop was pressed: release it, then motord reset")
        self.faults += faults
        return Held(tuple(found), faults)


def require_idle(client: Client) -> str:
    """Return the robot's name. Raises Failed for a robot that is not at rest and disarmed."""
    status = client.status()
    if status.state != "idle":
        why = "; ".join(status.why) or "see motord status"
        cure = "motord reset" if status.state in ("fault", "estop") else "motord disarm"
        raise Failed(f"the robot is {status.state} ({why}): {cure} first")
    return status.robot


@contextlib.contextmanager
def armed(client: Client, person: Person, owner: str) -> Iterator[Session]:
    """Arm a robot that is at rest and disarmed; disarm it at the end. Raises Failed if it is not at
    rest and disarmed, or is not seen at rest at the end, Refused if it cannot be armed."""
    name = require_idle(client)
    robot = client.call("robot")
    try:
        page = StatePage.open(name, owner=client.path.stat().st_uid)
    except NoPage as error:
        raise Failed(str(error)) from error
    with page, dead_man(client.path):
        session = Session(client, person, owner, page, robot)
        try:
            client.arm()
            # a program that ended a moment ago may have left its last command, which holds back all
            # that follow it until one is zero
            client.drive(0.0, 0.0, owner=owner)
            yield session
        finally:
            state = halt(client.path, "disarm")
            if state == "fault" and session.faults:
                with contextlib.suppress(ClientError):
                    client.reset()  # the fault came from the procedure, which explains it
            found = found_rest(client.path)
            if found.rest is not Rest.AT_REST:
                raise Failed(f"the robot is disarmed, but {found.text}")
