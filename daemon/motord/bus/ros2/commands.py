# SPDX-License-Identifier: Apache-2.0
"""Commands from ROS 2 nodes: cmd_vel under a lease, and services by the daemon's socket.

cmd_vel                           geometry_msgs/TwistStamped, or Twist (stamped = false)
~/arm, ~/disarm, ~/reset, ...     std_srvs/Trigger
~/set_armed                       std_srvs/SetBool: arm or disarm
joint_commands                    sensor_msgs/JointState: velocities by the joints' names; of
                                  joints without a base, positions too
drive_distance, rotate, calibrate motord_msgs actions
~/goal_alive                      unique_identifier_msgs/UUID: a goal's client lives (goal_lease_s)
~/stop, ~/estop                   std_srvs/Trigger; also topics (std_msgs/String: why), for
                                  nodes whose middleware our services do not reach
"""

from __future__ import annotations

import contextlib
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from motord.api.snapshot import stop_answer
from motord.bus.commands.gate import COMMANDS, TRIGGERS, URGENT, CommandGate, NotTaken
from motord.bus.commands.mover import Mover
from motord.bus.commands.senders import Sender
from motord.bus.commands.urgent import Urgent
from motord.bus.ros2.nodes import Node, node_of
from motord.bus.ros2.quality import Answer, Quality, Take
from motord.bus.ros2.senders import Contest, asker
from motord.bus.ros2.services.lifecycle import Lifecycle
from motord.bus.ros2.services.moves import Moves
from motord.bus.ros2.services.parameters import Parameters
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.ros2.dds.receiver import Twists
    from motord.bus.runtime import Runtime
    from motord.config import Ros2Input, ZenohInput

NEWEST = Quality(depth=1, reliable=False)
"""Receives from reliable and best-effort writers; an old command is of no use and is not sent
again."""
URGENT_RELIABLE = Quality(alone=False)
"""Used beside NEWEST: a reliable writer sends a sample again that the network lost."""

_WHY_CHARS = 150


class Ros2Commands:
    def __init__(
        self,
        name: str,
        section: Ros2Input | ZenohInput,
        runtime: Runtime,
        node: Node | None = None,
    ) -> None:
        """`node`: an existing node to use instead of the section's own. Raises DdsError."""
        self._name = name
        self._gate = CommandGate(name, section, runtime)
        self._node = node or node_of(runtime, section)
        self._stamped = section.stamped
        self._contests = {
            topic: Contest(f"input.{name}: {self._node.full(topic)}", section.lease_s)
            for topic in COMMANDS
        }
        self._gate.source.rivals = self._rivals
        self._urgent = {method: Urgent(name, method, runtime.call) for method in URGENT}
        self._twists = self._receiver(section) if node is None else None
        if self._twists is None:
            kind = "TwistStamped" if section.stamped else "Twist"
            self._node.subscribe("cmd_vel", f"geometry_msgs/msg/{kind}", self._drive, NEWEST)
        self._node.subscribe(
            "joint_commands", "sensor_msgs/msg/JointState", self._drive_joints, NEWEST
        )
        for method in TRIGGERS:
            self._node.serve(f"~/{method}", "std_srvs/srv/Trigger", self._trigger(method))
        self._node.serve("~/set_armed", "std_srvs/srv/SetBool", self._set_armed)
        for method, urgent in self._urgent.items():
            for quality in (URGENT_RELIABLE, NEWEST):
                self._node.subscribe(f"~/{method}", "std_msgs/msg/String", _asking(urgent), quality)
        Parameters(runtime.robot, self._gate.ask).serve(self._node)
        self._lifecycle = Lifecycle(runtime, self._gate)
        self._lifecycle.serve(self._node)
        self._mover = Mover(runtime, self._gate.source, self._gate.gap, section.lease_s)
        self._moves = Moves(runtime, self._mover, section.goal_lease_s)
        self._moves.serve(self._node)
        if section.goal_lease_s is not None:
            kind = "unique_identifier_msgs/msg/UUID"
            self._node.subscribe("~/goal_alive", kind, self._moves.alive, NEWEST)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        async with TaskGroup() as tasks:
            tasks.create_task(self._gate.source.run())
            tasks.create_task(self._node.run())
            tasks.create_task(self._lifecycle.run())
            for run in self._moves.runs():
                tasks.create_task(run())
            for urgent in self._urgent.values():
                tasks.create_task(urgent.run())
            if self._twists is not None:
                tasks.create_task(self._twists.run())

    def _receiver(self, section: Ros2Input | ZenohInput) -> Twists | None:
        """Return the receiver that takes cmd_vel without Python; None if cmd_vel passes through
        Python, as all other topics do."""
        from motord.config import Ros2Input  # not needed where the node is made elsewhere

        if not isinstance(section, Ros2Input) or not section.stamped:
            return None
        from motord.bus.ros2.dds import node, receiver

        over, made = self._node, receiver.library()
        if made is None or not isinstance(over, node.Node):
            return None
        reader = over.reader("cmd_vel", receiver.TYPE, receiver.NEWEST_FEW)

        def taken(writer: int, command: tuple[float, float, float], now_s: float) -> None:
            sender = over.writer_of(reader, writer)
            self._mover.driven(now_s)
            self._gate.name_absurd(*command, sender)
            self._contests["cmd_vel"].received(sender, command, now_s)

        return receiver.Twists(made, reader, self._gate, taken)

    def _drive(self, message: SimpleNamespace, waited_s: float, sender: Sender) -> None:
        with contextlib.suppress(NotTaken):  # logged by the command gate
            self._gate.drive(_as_mapping(message), waited_s, sender)
            self._mover.driven()
            twist = message.twist if self._stamped else message
            self._contests["cmd_vel"].received(
                sender.name, (twist.linear.x, twist.angular.z, twist.linear.y)
            )

    def _drive_joints(self, message: SimpleNamespace, waited_s: float, sender: Sender) -> None:
        with contextlib.suppress(NotTaken):
            command = _as_mapping(message)
            if not self._stamped:
                del command["header"]
            self._gate.drive_joints(command, waited_s, sender)
            self._mover.driven()
            self._contests["joint_commands"].received(
                sender.name, (*message.velocity, *message.position)
            )

    def _rivals(self) -> dict[str, Any]:
        """Return the senders that command against each other, by topic."""
        found = {topic: contest.report() for topic, contest in self._contests.items()}
        return {topic: rows for topic, rows in found.items() if rows}

    def _trigger(self, method: str) -> Answer:
        async def answer(_: SimpleNamespace) -> SimpleNamespace:
            return await self._acted(method)

        return answer

    async def _set_armed(self, request: SimpleNamespace) -> SimpleNamespace:
        return await self._acted("arm" if request.data else "disarm")

    async def _acted(self, method: str) -> SimpleNamespace:
        try:
            result = await self._gate.act(method, asker.get())
        except NotTaken as error:
            return SimpleNamespace(success=False, message=str(error))
        success, message = stop_answer(method, result)
        return SimpleNamespace(success=success, message=message)


def _asking(urgent: Urgent) -> Take:
    def ask(message: SimpleNamespace, _: float, sender: Sender) -> None:
        urgent.ask(f"by {sender.name}: {message.data[:_WHY_CHARS]!r}")

    return ask


def _as_mapping(value: Any) -> Any:
    """Return a decoded message as the mappings that the command gate takes."""
    if isinstance(value, SimpleNamespace):
        return {key: _as_mapping(item) for key, item in vars(value).items()}
    return value
