# SPDX-License-Identifier: Apache-2.0
"""A managed node's states and transitions, with the daemon's own table of states behind them."""

import asyncio
from pathlib import Path
from types import SimpleNamespace

import pytest

from motord.api.snapshot import STATES
from motord.bus.commands.gate import CommandGate
from motord.bus.ros2.services.lifecycle import Lifecycle
from motord.bus.runtime import Runtime
from motord.client import ClientError
from motord.config import Ros2Input, load_robot
from motord.control.machine import Event, Facts, Refusal, State, step

DEMO = Path(__file__).resolve().parents[3] / "config/robots/demo.toml"
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4
SHUTDOWN_UNCONFIGURED, SHUTDOWN_INACTIVE, SHUTDOWN_ACTIVE = 5, 6, 7


class Managed:
    """A managed node, and the daemon's state machine that it shows."""

    def __init__(self, state=State.IDLE):
        self.runtime = Runtime(load_robot(DEMO), Path("no.sock"))
        self.runtime.call = self._call
        self.asked, self.events, self._served, self.rest = [], [], {}, {}
        self.become(state)
        gate = CommandGate("ros2", Ros2Input(kind="ros2", lease_s=5.0), self.runtime)
        self.lifecycle = Lifecycle(self.runtime, gate)
        self.lifecycle.serve(self)

    def serve(self, name, _, answer):
        self._served[name] = answer

    def publisher(self, _name, _kind):
        return SimpleNamespace(publish=self.events.append)

    def become(self, state):
        self.state = state
        self.show()

    def show(self):
        """Let the state page show the machine's state."""
        state = self.state
        self.runtime.view = SimpleNamespace(
            snapshot=SimpleNamespace(machine_state=STATES.index(state.value))
        )

    def answering(self, answer):
        """Let `answer` take the place of the daemon's methods; `status` goes on."""

        async def call(method):
            return {"state": self.state.value} if method == "status" else await answer(method)

        self.runtime.call = call

    async def _call(self, method):
        if method == "status":
            return {"state": self.state.value, **self.rest}
        self.asked.append(method)
        target = step(self.state, Event(method), Facts())
        if isinstance(target, Refusal):
            raise ClientError(str(target))
        if target is State.STOPPING:
            target = step(target, Event.DISARMED, Facts())
        self.become(target)
        return {"state": target.value, **self.rest}

    async def change(self, number=0, label=""):
        wanted = SimpleNamespace(id=number, label=label)
        answer = await self._served["~/change_state"](SimpleNamespace(transition=wanted))
        return answer.success

    async def label(self):
        return (await self._served["~/get_state"](SimpleNamespace())).current_state.label

    async def described(self, service):
        answer = await self._served[f"~/{service}"](SimpleNamespace())
        return [
            (found.transition.id, found.transition.label, found.start_state.label)
            for found in answer.available_transitions
        ]

    def sent(self):
        return [
            (event.transition.label, event.start_state.label, event.goal_state.label)
            for event in self.events
        ]


async def test_a_manager_leads_the_node_through_all_its_states():
    node = Managed()
    walked = []
    for number in (CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP, CONFIGURE, CLEANUP, 5):
        assert await node.change(number)
        walked.append(await node.label())
    assert walked == [
        "inactive", "active", "inactive", "unconfigured", "inactive", "unconfigured", "finalized",
    ]  # fmt: skip
    assert node.asked == ["arm", "disarm", "disarm"]


async def test_a_transition_may_be_requested_by_its_label():
    node = Managed()
    for label in ("configure", "activate", "deactivate", "cleanup", "configure", "shutdown"):
        assert await node.change(label=label)
    assert await node.label() == "finalized"


async def test_a_manager_that_does_not_configure_finds_the_node_inactive():
    node = Managed()
    assert await node.label() == "inactive"
    assert await node.change(ACTIVATE)
    assert node.state is State.ARMED


async def test_nothing_but_activate_arms():
    node = Managed()
    for number in (CONFIGURE, CLEANUP, DEACTIVATE, CONFIGURE, 5, 6):
        await node.change(number)
    assert "arm" not in node.asked
    assert node.state is State.IDLE


async def test_an_unconfigured_node_is_not_activated_before_it_is_configured():
    node = Managed()
    assert await node.change(CLEANUP)
    assert not await node.change(ACTIVATE)
    assert not node.asked
    assert await node.change(CONFIGURE)
    assert await node.change(ACTIVATE)


@pytest.mark.parametrize(
    ("before", "number", "after"),
    [
        (State.ARMED, DEACTIVATE, "inactive"),
        (State.IDLE, CLEANUP, "inactive"),
        (State.IDLE, SHUTDOWN_INACTIVE, "inactive"),
        (State.ARMED, SHUTDOWN_ACTIVE, "inactive"),
    ],
)
async def test_a_transition_that_claims_rest_fails_while_rest_is_unknown(
    before, number, after, caplog
):
    node = Managed(before)
    node.rest = {"rest": "unknown", "rest_unknown_s": {"left": 2.0}, "rest_unmeasured": []}
    assert not await node.change(number)
    assert await node.label() == after
    assert node.state is State.IDLE  # its drives were disarmed all the same
    assert "motord cannot see whether left turns" in caplog.text
    node.rest = {"rest": "at_rest", "rest_unknown_s": {}, "rest_unmeasured": []}
    assert await node.change(CLEANUP)


async def test_an_unconfigured_node_is_not_finalized_while_rest_is_unknown():
    node = Managed()
    assert await node.change(CLEANUP)
    node.rest = {"rest": "unknown", "rest_unknown_s": {"left": 2.0}, "rest_unmeasured": []}
    assert not await node.change(SHUTDOWN_UNCONFIGURED)
    assert await node.label() == "unconfigured"


async def test_a_request_does_not_configure_a_robot_whose_drives_are_not_ready():
    for state in (State.OFF, State.CONFIGURING):
        node = Managed(state)
        assert not await node.change(CONFIGURE)
        assert node.state is state


async def test_a_held_node_reports_what_the_machine_does_as_soon_as_it_is_not_idle():
    node = Managed()
    assert await node.change(CLEANUP)
    node.become(State.CONFIGURING)
    assert await node.label() == "configuring"
    node.become(State.FAULT)
    assert await node.label() == "errorprocessing"
    node.become(State.IDLE)
    assert await node.label() == "unconfigured"
    node.become(State.MOVING)  # another program has armed the robot
    assert await node.label() == "active"
    node.become(State.IDLE)
    assert await node.label() == "inactive"


@pytest.mark.parametrize(("state", "number"), [(State.OFF, 5), (State.IDLE, 6), (State.MOVING, 7)])
async def test_shutdown_disarms_and_is_final(state, number):
    node = Managed(state)
    assert await node.change(number)
    assert not node.state.live
    assert node.asked == ["disarm"]
    for other in range(1, 9):
        assert not await node.change(other)
    node.become(State.CONFIGURING)
    assert await node.label() == "finalized"
    assert node.asked == ["disarm"]


async def test_a_refused_shutdown_leaves_the_node_active():
    node = Managed(State.ARMED)

    async def refuse(_):
        raise ClientError("the drive does not answer")

    node.answering(refuse)
    assert not await node.change(7)
    assert await node.label() == "active"


@pytest.mark.parametrize("state", [State.FAULT, State.ESTOP])
async def test_no_transition_leads_out_of_an_error(state):
    node = Managed(state)
    for number in range(1, 9):
        assert not await node.change(number)
    assert node.state is state
    assert await node.described("get_available_transitions") == []


@pytest.mark.parametrize("answer", ["fault", "idle"])
async def test_a_fault_while_the_robot_comes_to_rest_is_no_success(answer):
    """`answer`: the state in the daemon's answer, which may come before the fault."""
    node = Managed(State.MOVING)

    async def fail(_):
        node.become(State.FAULT)
        return {"state": answer}

    node.answering(fail)
    assert not await node.change(7)
    assert await node.label() == "errorprocessing"


async def test_the_state_is_the_new_one_when_the_answer_comes():
    node = Managed()

    async def slow(_):
        later = asyncio.get_running_loop().call_later
        later(0.05, node.become, State.ARMED)
        return {"state": "armed"}

    node.answering(slow)
    assert await node.change(ACTIVATE)
    assert await node.label() == "active"


LATE_S = 0.03


class Late(Managed):
    """A managed node whose state page shows each state of the machine later."""

    def become(self, state):
        self.state = state
        if self.runtime.view is None:
            self.show()
        else:
            asyncio.get_running_loop().call_later(LATE_S, self.show)


FIRST = {
    "reset": (State.ESTOP, State.IDLE, (CONFIGURE, ACTIVATE, CLEANUP, 6)),
    "arm": (State.IDLE, State.ARMED, (DEACTIVATE, 7)),
    "disarm": (State.ARMED, State.IDLE, (CONFIGURE, ACTIVATE, CLEANUP, 6)),
}


@pytest.mark.parametrize(
    ("first", "number"), [(first, number) for first, row in FIRST.items() for number in row[2]]
)
async def test_a_transition_right_after_an_answer_goes_by_the_state_in_the_answer(first, number):
    before, after, _ = FIRST[first]
    node = Late(before)
    assert (await node.runtime.call(first))["state"] == after.value
    assert await node.change(number)


async def test_the_state_right_after_an_answer_is_that_of_the_answer():
    node = Late(State.ESTOP)
    await node.runtime.call("reset")
    assert await node.label() == "inactive"


async def test_an_unconfigured_node_stays_so_while_the_page_still_shows_an_armed_robot():
    node = Late(State.ARMED)
    await node.runtime.call("disarm")
    assert await node.change(CLEANUP)
    assert not await node.change(ACTIVATE)
    assert await node.label() == "unconfigured"


async def test_a_daemon_that_does_not_answer_has_no_state_and_takes_no_transition():
    node = Managed(State.ARMED)

    async def lost(_):
        raise ClientError("no daemon")

    node.runtime.call = lost
    assert await node.label() == "unknown"
    assert not await node.change(DEACTIVATE)


async def test_each_step_is_published_as_an_event():
    node = Managed()
    for number in (CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP, CONFIGURE, 6):
        assert await node.change(number)
    assert node.sent() == [
        ("configure", "inactive", "configuring"),
        ("transition_success", "configuring", "inactive"),
        ("activate", "inactive", "active"),
        ("deactivate", "active", "inactive"),
        ("cleanup", "inactive", "unconfigured"),
        ("configure", "unconfigured", "configuring"),
        ("transition_success", "configuring", "inactive"),
        ("shutdown", "inactive", "finalized"),
    ]


async def test_transitions_have_the_standards_numbers_and_words():
    node = Managed()
    assert await node.described("get_transition_graph") == [
        (1, "configure", "unconfigured"), (1, "configure", "inactive"),
        (2, "cleanup", "inactive"), (3, "activate", "inactive"), (4, "deactivate", "active"),
        (5, "shutdown", "unconfigured"), (6, "shutdown", "inactive"), (7, "shutdown", "active"),
    ]  # fmt: skip
    await node.change(CLEANUP)
    offered = await node.described("get_available_transitions")
    assert [label for _, label, _ in offered] == ["configure", "shutdown"]
