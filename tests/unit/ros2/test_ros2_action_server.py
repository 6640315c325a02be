# SPDX-License-Identifier: Apache-2.0
"""An action's server: the goals that it takes and cancels, and its reports about them."""

import asyncio
import contextlib
from types import SimpleNamespace

import pytest

from motord.bus.messages.cdr import encode
from motord.bus.ros2.services.actions import GOALS_KEPT, ActionServer, Refused, Status, Turn

KIND = "motord_msgs/action/DriveDistance"
NOTHING = SimpleNamespace(distance_m=0.0, turned_rad=0.0, duration_s=0.0, message="")
NO_ID, NOW = bytes(16), 0
LOOK_S = 0.005


class Node:
    """A node that keeps what is served and published; it encodes each message as for the wire."""

    def __init__(self):
        self.answers, self.sent = {}, []

    def serve(self, name, kind, answer, depth=10, together=1):
        async def checked(request):
            reply = await answer(request)
            encode(f"{kind}_Response", reply)
            return reply

        self.answers[name.rpartition("/")[2]] = checked

    def publisher(self, name, kind, quality=None):
        def publish(message):
            encode(kind, message)
            self.sent.append((name.rpartition("/")[2], message))

        return SimpleNamespace(publish=publish)

    def states(self):
        last = [message for name, message in self.sent if name == "status"][-1]
        return [state.status for state in last.status_list]


class Bench:
    """A server whose goals last until `go` is set or they are cancelled."""

    def __init__(self, name="drive_distance", turn=None, goal_lease_s=None):
        self.node, self.go, self.turn = Node(), asyncio.Event(), turn or Turn()
        self.server = ActionServer(name, KIND, self.accept, NOTHING, self.turn, goal_lease_s)
        self.server.serve(self.node)

    async def accept(self, goal):
        if goal.distance_m == 0.0:
            raise Refused("a way of 0 is none")
        if goal.distance_m < 0.0:
            await asyncio.Event().wait()

        async def work(report, cancel):
            report(SimpleNamespace(distance_m=0.0, remaining_m=1.0, speed_m_s=0.0))
            while not self.go.is_set() and not cancel.is_set():
                await asyncio.sleep(LOOK_S)
                report(SimpleNamespace(distance_m=0.0, remaining_m=1.0, speed_m_s=0.0))
            return (Status.CANCELED if cancel.is_set() else Status.SUCCEEDED), NOTHING

        return work

    async def send(self, number, distance_m=1.0):
        goal = SimpleNamespace(distance_m=distance_m)
        request = SimpleNamespace(goal_id=uuid(number), goal=goal)
        return await self.node.answers["send_goal"](request)

    async def cancel(self, number=NO_ID, stamp_ns=NOW):
        stamp = SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        info = SimpleNamespace(goal_id=uuid(number), stamp=stamp)
        reply = await self.node.answers["cancel_goal"](SimpleNamespace(goal_info=info))
        return reply.return_code, [bytes(found.goal_id.uuid) for found in reply.goals_canceling]

    async def result(self, number):
        return (await self.node.answers["get_result"](SimpleNamespace(goal_id=uuid(number)))).status


def uuid(number):
    return SimpleNamespace(uuid=tuple(number))


def number(value):
    return bytes([value]) * 16


@contextlib.asynccontextmanager
async def running(*benches):
    async with asyncio.timeout(20.0), asyncio.TaskGroup() as tasks:
        work = [tasks.create_task(bench.server.run()) for bench in benches]
        yield
        for task in work:
            task.cancel()


async def test_a_goal_is_accepted_executed_and_has_a_result():
    bench = Bench()
    async with running(bench):
        reply = await bench.send(number(1))
        assert reply.accepted
        assert reply.stamp.sec > 0
        bench.go.set()
        assert await bench.result(number(1)) == Status.SUCCEEDED
    seen = [
        m.status_list[0].status for name, m in bench.node.sent if name == "status" and m.status_list
    ]
    assert list(dict.fromkeys(seen)) == [Status.ACCEPTED, Status.EXECUTING, Status.SUCCEEDED]
    feedback = next(message for name, message in bench.node.sent if name == "feedback")
    assert bytes(feedback.goal_id.uuid) == number(1)


async def test_servers_that_take_turns_run_one_goal_at_a_time():
    turn = Turn()
    one, other = Bench(turn=turn), Bench("rotate", turn)
    async with running(one, other):
        assert (await one.send(number(1))).accepted
        assert not (await one.send(number(2))).accepted
        assert not (await other.send(number(3))).accepted
        one.go.set()
        await one.result(number(1))
        assert (await other.send(number(3))).accepted
        assert not (await one.send(number(1))).accepted  # the number is already in use
        other.go.set()
        await other.result(number(3))


async def test_a_refusal_leaves_the_turn_to_others():
    bench = Bench()
    async with running(bench):
        assert not (await bench.send(number(1), distance_m=0.0)).accepted
        assert (await bench.send(number(2))).accepted
        bench.go.set()
        await bench.result(number(2))
    assert await bench.result(number(1)) == Status.UNKNOWN


async def test_a_goal_is_cancelled_by_its_number_by_time_or_with_all_others():
    bench = Bench()
    async with running(bench):
        assert await bench.cancel() == (0, [])
        assert await bench.cancel(number(1)) == (2, [])
        for value, how in ((1, {"number": number(1)}), (2, {"stamp_ns": 1 << 62}), (3, {})):
            assert (await bench.send(number(value))).accepted
            assert await bench.cancel(stamp_ns=1) == (0, [])  # no goal is so old
            assert await bench.cancel(number(99)) == (2, [])
            assert await bench.cancel(**how) == (0, [number(value)])
            assert await bench.result(number(value)) == Status.CANCELED
            assert await bench.cancel(number(value)) == (3, [])
    assert bench.node.states() == [Status.CANCELED] * 3


async def test_a_goal_that_is_cancelled_before_it_begins_ends_as_cancelled():
    bench = Bench()
    assert (await bench.send(number(1))).accepted
    assert (await bench.cancel())[1] == [number(1)]
    async with running(bench):
        assert await bench.result(number(1)) == Status.CANCELED
    assert Status.EXECUTING not in bench.node.states()


async def test_a_goal_is_aborted_when_its_node_ends_and_others_may_follow():
    bench = Bench()
    async with running(bench):
        await bench.send(number(1))
        await becomes(lambda: bench.node.states() == [Status.EXECUTING])
    async with running(bench):
        assert await bench.result(number(1)) == Status.ABORTED
        await becomes(lambda: bench.node.states() == [Status.ABORTED])
        assert (await bench.send(number(2))).accepted


async def test_a_goal_that_was_not_begun_when_the_node_ended_is_never_begun():
    bench = Bench()
    await bench.send(number(1))
    bench.server.serve(bench.node)
    async with running(bench):
        assert await bench.result(number(1)) == Status.ABORTED
        assert "feedback" not in [name for name, _ in bench.node.sent]
        assert (await bench.send(number(2))).accepted


async def test_a_request_that_is_given_up_before_it_is_accepted_leaves_the_turn_to_others():
    bench = Bench()
    async with running(bench):
        sending = asyncio.ensure_future(bench.send(number(1), distance_m=-1.0))
        await becomes(lambda: bench.turn.holder)
        sending.cancel()
        await asyncio.wait([sending])
        assert (await bench.send(number(2))).accepted


async def becomes(true):
    while not true():
        await asyncio.sleep(0.0)


async def test_only_the_newest_goals_are_remembered():
    bench = Bench()
    bench.go.set()
    async with running(bench):
        for value in range(1, GOALS_KEPT + 4):
            assert (await bench.send(number(value))).accepted
            await bench.result(number(value))
    assert len(bench.node.states()) == GOALS_KEPT
    assert await bench.result(number(1)) == Status.UNKNOWN
    assert await bench.result(number(GOALS_KEPT + 3)) == Status.SUCCEEDED


async def test_each_reason_of_a_refusal_is_reported_but_not_each_time(caplog):
    bench = Bench()
    async with running(bench):
        for _ in range(50):
            await bench.send(number(1), distance_m=0.0)
        await bench.send(number(2))
        await bench.send(number(3))
        bench.go.set()
        await bench.result(number(2))
    messages = [record.getMessage() for record in caplog.records]
    assert sum("a way of 0" in text for text in messages) == 1
    assert sum("is running" in text for text in messages) == 1


@pytest.mark.parametrize("status", [Status.SUCCEEDED, Status.CANCELED, Status.ABORTED])
def test_the_states_have_the_numbers_of_action_msgs(status):
    assert {Status.SUCCEEDED: 4, Status.CANCELED: 5, Status.ABORTED: 6}[status] == int(status)


async def test_a_goal_whose_client_is_silent_for_its_lease_comes_to_rest_and_is_aborted():
    bench = Bench(goal_lease_s=0.1)
    async with running(bench):
        await bench.send(number(1))
        request = SimpleNamespace(goal_id=uuid(number(1)))
        found = await bench.node.answers["get_result"](request)
    assert found.status == Status.ABORTED
    assert found.result.message == "its client was silent for 0.1 s"


async def test_a_goal_goes_on_while_its_own_client_lives():
    bench = Bench(goal_lease_s=5.0)
    async with running(bench):
        await bench.send(number(1))
        goal = bench.server._goals[number(1)]
        goal.alive_s -= 4.9  # nearly all of its lease
        bench.server.alive(number(2))  # the client of another goal
        silent_s = goal.alive_s
        bench.server.alive(number(1))
        assert goal.alive_s > silent_s + 4.0
        bench.go.set()
        assert await bench.result(number(1)) == Status.SUCCEEDED


async def test_a_goal_that_its_client_cancels_is_canceled_though_the_lease_has_lapsed():
    bench = Bench(goal_lease_s=5.0)
    async with running(bench):
        await bench.send(number(1))
        await bench.cancel(number(1))
        bench.server._goals[number(1)].alive_s -= 10.0
        assert await bench.result(number(1)) == Status.CANCELED
