# SPDX-License-Identifier: Apache-2.0
"""Serves the node's parameters by the services and the topic that every ROS 2 node has for them."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from motord.bus.commands.gate import NotTaken
from motord.bus.parameters import Call, Tunable, value_of
from motord.bus.ros2.nodes import Node
from motord.bus.ros2.quality import Quality

if TYPE_CHECKING:
    from motord.config import Robot

NOT_SET, DOUBLE = 0, 3
"""Numbers of rcl_interfaces/msg/ParameterType."""
DEPTH = 1000
"""Depth of rmw_qos_profile_parameters."""
_EMPTY: dict[str, Any] = {
    "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
    "byte_array_value": (), "bool_array_value": (), "integer_array_value": (),
    "double_array_value": (), "string_array_value": (),
}  # fmt: skip


class Parameters:
    def __init__(self, robot: Robot, call: Call) -> None:
        """`call`: see `Tunable`."""
        self._tunable = Tunable(robot, call)

    def serve(self, node: Node) -> None:
        """Offer the services for parameters that every ROS 2 node has. Raises DdsError."""
        for name, answer in {
            "ListParameters": self._list,
            "GetParameters": self._get,
            "GetParameterTypes": self._types,
            "DescribeParameters": self._describe,
            "SetParameters": self._set,
            "SetParametersAtomically": self._set_together,
        }.items():
            node.serve(f"~/{_snake(name)}", f"rcl_interfaces/srv/{name}", answer, DEPTH)
        self._node = node.full("~/").rstrip("/")
        self._events = node.publisher(
            "/parameter_events", "rcl_interfaces/msg/ParameterEvent", Quality(depth=DEPTH)
        )

    async def _list(self, request: SimpleNamespace) -> SimpleNamespace:
        names = [
            name
            for name in await self._tunable.known()
            if _listed(name, request.prefixes, request.depth)
        ]
        prefixes = sorted({name.rpartition(".")[0] for name in names})
        return SimpleNamespace(result=SimpleNamespace(names=names, prefixes=prefixes))

    async def _get(self, request: SimpleNamespace) -> SimpleNamespace:
        known = await self._tunable.known()
        return SimpleNamespace(values=[_value(known.get(name)) for name in request.names])

    async def _types(self, request: SimpleNamespace) -> SimpleNamespace:
        known = await self._tunable.known()
        types = [DOUBLE if name in known else NOT_SET for name in request.names]
        return SimpleNamespace(types=types)

    async def _describe(self, request: SimpleNamespace) -> SimpleNamespace:
        known = await self._tunable.known()
        found = [name for name in request.names if name in known]
        return SimpleNamespace(
            descriptors=[
                _descriptor(name, known[name], name in self._tunable.fixed) for name in found
            ]
        )

    async def _set(self, request: SimpleNamespace) -> SimpleNamespace:
        results = [await self._change([parameter]) for parameter in request.parameters]
        return SimpleNamespace(results=results)

    async def _set_together(self, request: SimpleNamespace) -> SimpleNamespace:
        return SimpleNamespace(result=await self._change(request.parameters))

    async def _change(self, parameters: Sequence[SimpleNamespace]) -> SimpleNamespace:
        wanted: dict[str, float] = {}
        for parameter in parameters:
            if (reason := self._problem(parameter)) is not None:
                return SimpleNamespace(successful=False, reason=reason)
            wanted[parameter.name] = parameter.value.double_value
        try:
            await self._tunable.change(wanted)
        except NotTaken as error:
            return SimpleNamespace(successful=False, reason=str(error))
        self._events.publish(_event(self._node, parameters))
        return SimpleNamespace(successful=True, reason="")

    def _problem(self, parameter: SimpleNamespace) -> str | None:
        """Return why a change is refused, as far as that is clear without the daemon; None if it is
        not."""
        name = parameter.name
        if (reason := self._tunable.problem(name)) is not None:
            return reason
        return None if parameter.value.type == DOUBLE else f"{name} is a double (write 1.0, not 1)"


def _event(node: str, changed: Sequence[SimpleNamespace]) -> SimpleNamespace:
    """Return an rcl_interfaces/ParameterEvent with the current time."""
    sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
    return SimpleNamespace(
        stamp=SimpleNamespace(sec=sec, nanosec=nanosec),
        node=node,
        new_parameters=(),
        changed_parameters=changed,
        deleted_parameters=(),
    )


def _listed(name: str, prefixes: Sequence[str], depth: int) -> bool:
    """Return whether a name belongs to the list, as rcl_interfaces/srv/ListParameters defines it;
    depth 0 is any depth."""
    for prefix in prefixes or ("",):
        below = name.removeprefix(f"{prefix}.") if prefix else name
        if prefix and below == name:
            if name == prefix:
                return True
            continue
        if depth == 0 or below.count(".") < depth:
            return True
    return False


def _value(about: Mapping[str, Any] | None) -> SimpleNamespace:
    """Return the ParameterValue of a parameter; NOT_SET for None. JSON has no infinity, so null
    stands for it."""
    if about is None:
        return SimpleNamespace(**_EMPTY | {"type": NOT_SET})
    return SimpleNamespace(**_EMPTY | {"type": DOUBLE, "double_value": value_of(about)})


def _descriptor(name: str, about: Mapping[str, Any], fixed: bool) -> SimpleNamespace:
    ranges = []
    if not fixed:
        high = math.inf if about["maximum"] is None else about["maximum"]
        ranges = [SimpleNamespace(from_value=about["minimum"], to_value=high, step=0.0)]
    return SimpleNamespace(
        name=name,
        type=DOUBLE,
        description=f"{about['description']} [{about['unit']}]",
        additional_constraints="",
        read_only=fixed,
        dynamic_typing=False,
        floating_point_range=ranges,
        integer_range=(),
    )


def _snake(name: str) -> str:
    """Return the snake case of a name: list_parameters for ListParameters."""
    return "".join(f"_{char.lower()}" if char.isupper() else char for char in name)[1:]
