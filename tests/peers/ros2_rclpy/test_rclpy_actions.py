# SPDX-License-Identifier: Apache-2.0
"""Actions of the bridge node, used through the services and topics of which an action consists."""

import math
import uuid

import pytest
from tests.peers.ros2_rclpy.rclpy_rig import T, drive_until, twist
from tests.peers.ros2_rclpy.rclpy_stage import BEST_EFFORT, LATCHED, answered, bridged
from tests.sim.daemon_stage import wait_until

actions = pytest.importorskip(
    "motord_msgs.action", reason="needs motord_msgs: motord ros2-msgs, colcon build"
)
from action_msgs.msg import GoalInfo, GoalStatusArray  # noqa: E402
from action_msgs.srv import CancelGoal  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from unique_identifier_msgs.msg import UUID  # noqa: E402

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
WAITING = 12
"""Number of requests for one result: a service of rclpy keeps fewer answers by default."""
KINDS = {
    "drive_distance": actions.DriveDistance,
    "rotate": actions.Rotate,
    "calibrate": actions.Calibrate,
}


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with bridged(tmp_path_factory.mktemp("rclpy"), "input.person.kind=socket") as stage:
        yield stage


@pytest.fixture
def armed(stage):
    """The robot, armed. A fault that a busy machine has latched meanwhile is reset."""

    def attempt():
        method = {"fault": "reset", "estop": "reset", "idle": "arm"}.get(stage.state())
        if method is not None:
            stage.operator.call(f"motord/{method}", Trigger)
        return stage.state() == "armed"

    wait_until(lambda: not stage.robot.status()["leases"], "the command's end")
    wait_until(attempt, "armed")
    return stage


class Goal:
    def __init__(self, stage, name, **values):
        self._stage, self._name, self._kind = stage, name, KINDS[name]
        self.number = UUID(uuid=list(uuid.uuid4().bytes))
        answer = self._call("send_goal", self._kind.Impl.SendGoalService, goal=self._goal(values))
        self.accepted = answer.accepted

    def _goal(self, values):
        made = self._kind.Goal()
        for key, value in values.items():
            setattr(made, key, value)
        return made

    def _call(self, service, kind, **values):
        full = f"{self._name}/_action/{service}"
        return self._stage.operator.call(full, kind, goal_id=self.number, **values)

    def asked(self):
        return self._stage.operator.ask(
            f"{self._name}/_action/get_result", self._kind.Impl.GetResultService,
            goal_id=self.number,
        )  # fmt: skip

    def result(self):
        answer = answered(self.asked(), "the result")
        return answer.status, answer.result

    def cancel(self):
        info = GoalInfo(goal_id=self.number)
        name = f"{self._name}/_action/cancel_goal"
        return len(self._stage.operator.call(name, CancelGoal, goal_info=info).goals_canceling)


def wait_for_motion(stage):
    wait_until(lambda: not stage.sim.truth().at_rest, "the wheels turn")


def at_rest(stage):
    wait_until(lambda: stage.sim.truth().at_rest, "the wheels rest")


def test_a_distance_is_driven_with_feedback_while_it_moves(armed):
    kind = actions.DriveDistance.Impl.FeedbackMessage
    received = armed.operator.collect("drive_distance/_action/feedback", kind)
    states = armed.operator.collect("drive_distance/_action/status", GoalStatusArray, LATCHED)
    before = armed.sim.truth()
    goal = Goal(armed, "drive_distance", distance_m=0.4)
    assert goal.accepted
    status, sent = goal.result()
    assert (status, sent.message) == (SUCCEEDED, "")
    assert sent.distance_m == pytest.approx(0.4, abs=0.011)
    after = armed.sim.truth()
    assert math.hypot(after.x_m - before.x_m, after.y_m - before.y_m) == pytest.approx(0.4, abs=0.1)
    assert received
    assert bytes(received[-1].goal_id.uuid) == bytes(goal.number.uuid)
    wait_until(lambda: states and states[-1].status_list[-1].status == SUCCEEDED, "the state")
    assert goal.result()[0] == SUCCEEDED  # another request gets the answer, too


def test_an_angle_is_turned(armed):
    goal = Goal(armed, "rotate", angle_rad=-0.5)
    status, sent = goal.result()
    assert (status, sent.message) == (SUCCEEDED, "")
    assert sent.angle_rad == pytest.approx(-0.5, abs=0.021)


def test_a_cancelled_goal_ends_at_rest(armed):
    goal = Goal(armed, "drive_distance", distance_m=20.0)
    wait_for_motion(armed)
    assert not Goal(armed, "rotate", angle_rad=1.0).accepted
    assert goal.cancel() == 1
    status, sent = goal.result()
    assert (status, sent.message) == (CANCELED, "canceled")
    at_rest(armed)


def test_a_stop_gets_through_while_many_clients_wait_for_results(armed):
    goal = Goal(armed, "drive_distance", distance_m=20.0)
    wait_for_motion(armed)
    waiting = [goal.asked() for _ in range(WAITING)]
    assert armed.operator.call("motord/stop", Trigger).success
    status, sent = goal.result()
    assert status == ABORTED
    assert sent.message
    for future in waiting:
        assert answered(future, "a result").status == ABORTED
    at_rest(armed)


@pytest.mark.parametrize("distance_m", [0.0, math.nan, math.inf])
def test_a_distance_that_is_zero_or_not_finite_is_refused(armed, distance_m):
    assert not Goal(armed, "drive_distance", distance_m=distance_m).accepted
    assert armed.sim.truth().at_rest


def test_a_source_of_higher_priority_ends_the_goal(armed):
    future = Goal(armed, "drive_distance", distance_m=20.0).asked()
    wait_for_motion(armed)

    def taken_over():
        armed.robot.drive(0.0, 0.0, priority=900, owner="person")
        return future.done()

    wait_until(taken_over, "a result")
    assert future.result().result.message == "another source commands"
    at_rest(armed)


def test_a_command_on_the_same_input_ends_the_goal(armed):
    publisher = armed.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)
    future = Goal(armed, "drive_distance", distance_m=20.0).asked()
    wait_for_motion(armed)
    drive_until(armed, publisher, lambda: twist(0.0), future.done, "a result")
    assert future.result().status == ABORTED
    at_rest(armed)


def test_a_base_that_cannot_move_sideways_refuses_a_sideways_goal(armed):
    goal = Goal(armed, "drive_distance", distance_m=1.0, direction_rad=math.pi / 2)
    assert not goal.accepted
    assert armed.sim.truth().at_rest
    assert armed.operator.call("motord/stop", Trigger).success  # the bridge still serves


def test_a_calibration_moves_nothing_and_ends_when_cancelled(armed):
    assert not Goal(armed, "calibrate", quantity="luck", true_distance_m=1.0).accepted
    goal = Goal(armed, "calibrate", quantity="wheel_radius", true_distance_m=0.5)
    assert goal.accepted
    assert armed.sim.truth().at_rest
    assert goal.cancel() == 1
    assert goal.result()[0] == CANCELED


def test_a_disarmed_robot_refuses_a_goal(stage):
    stage.robot.disarm()
    stage.wait_for("idle")

    def refused():
        """Return whether the log has the reason. On a busy machine old odometry may come first."""
        assert not Goal(stage, "drive_distance", distance_m=0.5).accepted
        return "not armed" in stage.bridge.logged()

    wait_until(refused, "the reason in the log")
