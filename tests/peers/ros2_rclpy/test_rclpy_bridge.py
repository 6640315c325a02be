# SPDX-License-Identifier: Apache-2.0
"""The bridge node, which serves through rclpy what motord-bus serves on DDS."""

import contextlib
import math
import signal
import time
from functools import partial

import pytest
from tests.peers.ros2_rclpy.rclpy_rig import T, Trigger, drive_until, stamped, trigger, twist
from tests.peers.ros2_rclpy.rclpy_stage import (
    BEST_EFFORT,
    LEASE_S,
    UNWARNED,
    bridge,
    bridged,
    operator,
)
from tests.sim.daemon_stage import DEADLINE_S, wait_until

from motord.bus.commands.gate import TRIGGERS
from motord.client import ClientError

pytestmark = UNWARNED


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    with bridged(tmp_path_factory.mktemp("rclpy")) as stage:
        yield stage


@pytest.fixture(autouse=True)
def settled(stage):
    """Wait until the robot is idle with no source in command."""
    wait_until(lambda: not stage.robot.status()["leases"], "the command's end")

    def ready():
        state = stage.state()
        try:
            if state in ("fault", "estop"):
                stage.robot.reset()
            elif state not in ("idle", "configuring"):
                stage.robot.disarm()
        except ClientError:
            return False
        return state == "idle"

    wait_until(ready, "idle")


def armed(stage):
    wait_until(lambda: trigger(stage, "arm")[0] or not trigger(stage, "reset"), "armed")


def test_services_answer_with_the_state_or_the_reason(stage):
    armed(stage)
    assert trigger(stage, "estop") == (True, "estop")
    done, why = trigger(stage, "arm")
    assert not done
    assert "emergency stop" in why
    assert trigger(stage, "reset") == (True, "idle")
    assert trigger(stage, "reset_odometry") == (True, "idle")
    answer = stage.operator.call("motord/set_armed", T.SetBool, data=True)
    assert (answer.success, answer.message) == (True, "armed")
    assert trigger(stage, "stop") == (True, "armed")
    answer = stage.operator.call("motord/set_armed", T.SetBool, data=False)
    assert (answer.success, answer.message) == (True, "idle")


def test_every_service_of_the_daemon_is_served(stage):
    for method in TRIGGERS:
        assert "unknown" not in trigger(stage, method)[1].lower()


def test_commands_move_the_robot_under_the_lease_of_the_input(stage):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)
    drive_until(stage, publisher, lambda: twist(0.2), lambda: stage.state() == "moving", "moving")
    (lease,) = stage.robot.status()["leases"]
    assert (lease["owner"], lease["priority"]) == ("ros", 60)
    stage.wait_for("armed", "fault")


def test_a_sideways_speed_reaches_the_daemon_which_counts_it_as_impossible(stage):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)

    def lateral_m_s():
        return [one["lateral_m_s"] for one in stage.robot.status()["leases"]]

    command = partial(twist, 0.2, lateral_m_s=0.1)
    drive_until(stage, publisher, command, lambda: lateral_m_s() == [0.1], "the lateral speed")
    drive_until(stage, publisher, command, lambda: stage.state() == "moving", "moving")
    assert stage.robot.status()["commands"]["sideways"] > 0
    assert stage.logged().count("asks this base to move sideways") == 1


def test_a_command_far_beyond_the_limit_is_logged_by_the_bridge_and_moves_nothing(stage):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)

    def logged():
        return "requests 1000 m/s" in stage.bridge.logged()

    drive_until(stage, publisher, partial(twist, 1000.0), logged, "the speed in the log")
    assert stage.sim.truth().at_rest


def test_nodes_that_command_against_each_other_are_reported(stage):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)
    with operator("rival") as rival:
        other = rival.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)

        def reported():
            other.publish(twist(-0.1))
            return "against each other" in stage.bridge.logged()

        drive_until(stage, publisher, partial(twist, 0.1), reported, "both in the log")


def test_wheels_are_commanded_by_their_names(stage):
    armed(stage)
    publisher = stage.operator.publisher("joint_commands", T.JointState)

    def back():
        return stamped(T.JointState(name=["right", "left"], velocity=[-2.0, -2.0]))

    drive_until(
        stage, publisher, back,
        lambda: all(joint.velocity_rad_s < -1.0 for joint in stage.sim.truth().joints.values()),
        "backwards",
    )  # fmt: skip
    stage.wait_for("armed", "fault")


def test_a_delayed_command_is_refused_by_the_loop(stage):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)

    def refused():
        return stage.robot.status()["commands"]["refused"]["age"]

    before = refused()
    drive_until(stage, publisher, lambda: twist(0.2, age_s=30.0), lambda: refused() > before, "no")
    assert stage.state() != "moving"


@pytest.mark.parametrize(
    ("stamp", "why"), [((0, 0), "zero"), ((2**31 - 1, 0), "future")], ids=["zero", "future"]
)
def test_a_command_with_an_unusable_stamp_is_not_passed_on(stage, stamp, why):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)
    before = stage.robot.status()["commands"]

    def bad():
        message = twist(0.2)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        return message

    for _ in range(20):
        publisher.publish(bad())
    assert trigger(stage, "stop")[0]  # the bridge has handled the messages published before
    assert stage.robot.status()["commands"] == before


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_command_that_is_not_finite_moves_nothing(stage, value):
    armed(stage)
    publisher = stage.operator.publisher("cmd_vel", T.TwistStamped, BEST_EFFORT)

    def counted():
        return stage.robot.status()["commands"]

    before = counted()
    drive_until(stage, publisher, lambda: twist(value), lambda: counted() != before, "a count")
    assert stage.sim.truth().at_rest


@pytest.mark.parametrize("quality", [10, BEST_EFFORT], ids=["reliable", "best effort"])
def test_the_estop_topic_stops_and_names_the_node(stage, quality):
    with operator("person") as person:
        publisher = person.publisher("motord/estop", T.String, quality)
        within_s = 5.0 if quality is BEST_EFFORT else DEADLINE_S

        def stopped():
            """Publish, and return whether the robot stops: a best-effort message may be lost."""
            publisher.publish(T.String(data="a hand is in the belt"))
            with contextlib.suppress(AssertionError):
                return wait_until(lambda: stage.state() == "estop", "estop", within_s)
            return False

        def named():
            """Return whether the reason names the node: ROS 2 may learn its name too late."""
            wait_until(stopped, f"an emergency stop\n{stage.logged()}")
            why = wait_until(
                lambda: [text for text in stage.robot.status()["why"] if "belt" in text],
                "the reason",
            )
            assert trigger(stage, "reset") == (True, "idle")
            return "/r2/person" in why[0]

        wait_until(named, "the name of the node")


def test_robot_parameters_are_listed_read_and_set_with_reasons(stage):
    ask = stage.operator.call
    names = ask("motord/list_parameters", T.ListParameters).result.names
    assert {"limits.linear_m_s", "base.track_m"} <= set(names)
    (value,) = ask("motord/get_parameters", T.GetParameters, names=["limits.linear_m_s"]).values
    (found,) = ask(
        "motord/describe_parameters", T.DescribeParameters, names=["base.track_m"]
    ).descriptors
    assert found.read_only
    (kind,) = ask(
        "motord/get_parameter_types", T.GetParameterTypes, names=["limits.linear_m_s"]
    ).types
    assert kind == value.type == 3
    events = stage.operator.collect("/parameter_events", T.ParameterEvent, 1000)

    def put(name, number):
        wanted = T.Parameter(name=name, value=T.ParameterValue(type=3, double_value=number))
        (result,) = ask("motord/set_parameters", T.SetParameters, parameters=[wanted]).results
        return result.successful, result.reason

    assert put("limits.linear_m_s", 0.25) == (True, "")
    assert stage.robot.params_get("limits.linear_m_s") == {"limits.linear_m_s": 0.25}
    wait_until(
        lambda: any(
            changed.name == "limits.linear_m_s" for event in events
            for changed in event.changed_parameters
        ), "an event",
    )  # fmt: skip
    assert put("limits.linear_m_s", value.double_value) == (True, "")
    for name, number, why in (
        ("limits.linear_m_s", -1.0, "limits.linear_m_s"),
        ("base.track_m", 1.0, "robot file"),
        ("nonsense", 1.0, "no parameter"),
    ):
        done, reason = put(name, number)
        assert not done
        assert why in reason


def test_a_manager_takes_the_bridge_through_the_life_cycle(stage):
    ask = stage.operator.call
    events = stage.operator.collect("motord/transition_event", T.TransitionEvent)

    def walk(number):
        wanted = T.Transition(id=number)
        return ask("motord/change_state", T.ChangeState, transition=wanted).success

    def now():
        return ask("motord/get_state", T.GetState).current_state.label

    assert len(ask("motord/get_available_states", T.GetAvailableStates).available_states) == 7
    wait_until(lambda: now() == "inactive", "inactive")
    assert walk(1)
    assert walk(3)
    assert (now(), stage.state()) == ("active", "armed")
    assert not walk(1)
    assert walk(4)
    assert (now(), stage.state()) == ("inactive", "idle")
    assert walk(2)
    assert now() == "unconfigured"
    assert not walk(3)
    assert walk(1)
    graph = ask("motord/get_transition_graph", T.GetAvailableTransitions)
    assert len(graph.available_transitions) == 8
    ask("motord/get_available_transitions", T.GetAvailableTransitions)
    wait_until(lambda: any(event.transition.label == "activate" for event in events), "an event")


def test_an_estop_is_an_error_for_a_manager_and_no_transition_leads_out_of_it(stage):
    assert trigger(stage, "estop")[0]
    wait_until(
        lambda: stage.operator.call("motord/get_state", T.GetState).current_state.label
        == "errorprocessing", "an error",
    )  # fmt: skip
    for number in range(1, 8):
        wanted = T.Transition(id=number)
        assert not stage.operator.call("motord/change_state", T.ChangeState, transition=wanted)\
            .success  # fmt: skip
    assert stage.state() == "estop"
    assert trigger(stage, "reset") == (True, "idle")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_the_end_of_a_bridge_ends_its_lease_and_the_robot_rests(stage, tmp_path, number):
    """The bridge of this test runs beside that of the stage, for the same input."""
    armed(stage)
    with bridge(
        tmp_path, "--socket", stage.socket, "--unstamped",
        ros_args=("-r", "cmd_vel:=safe_cmd_vel", "-r", "__node:=second"),
    ) as other:  # fmt: skip
        publisher = stage.operator.publisher("safe_cmd_vel", T.Twist)

        def onward():
            message = T.Twist()
            message.linear.x = 0.2
            return message

        drive_until(stage, publisher, onward, lambda: stage.state() == "moving", "moving")
        other.process.send_signal(number)
        assert other.wait() == (0 if number == signal.SIGTERM else -signal.SIGKILL), other.logged()
    wait_until(lambda: not stage.robot.status()["leases"], "no source in command")
    stage.wait_for("armed", "fault")
    wait_until(lambda: stage.sim.truth().at_rest, "rest")


def test_commands_queued_while_the_bridge_stood_still_move_nothing(stage, tmp_path):
    armed(stage)
    with bridge(
        tmp_path, "--socket", stage.socket, "--unstamped",
        ros_args=("-r", "cmd_vel:=other_cmd_vel", "-r", "__node:=third"),
    ) as other:  # fmt: skip
        publisher = stage.operator.publisher("other_cmd_vel", T.Twist)
        rest = T.Twist()

        def accepted():
            return stage.robot.status()["commands"]["accepted"]

        def looked_at():
            """Return the accepted commands after the bridge has handled all messages so far."""
            assert stage.operator.call("third/stop", Trigger).success
            return accepted()

        before = accepted()
        drive_until(stage, publisher, lambda: rest, lambda: accepted() > before, "a lease")
        taken = looked_at()
        other.process.send_signal(signal.SIGSTOP)
        stopped_s = time.monotonic()
        wait_until(lambda: time.monotonic() > stopped_s + 2.0 * LEASE_S, "a pause")
        message = T.Twist()
        message.linear.x = 0.2
        publisher.publish(message)
        other.process.send_signal(signal.SIGCONT)
        assert looked_at() == taken
        assert stage.state() != "moving"


def test_an_unstamped_command_does_not_arrive_where_stamps_are_required(stage):
    """It has another type on the same topic: Twist instead of TwistStamped."""
    armed(stage)
    before = stage.robot.status()["commands"]
    with operator("stranger") as stranger:
        publisher = stranger.node.create_publisher(T.Twist, "cmd_vel", 10)
        for _ in range(20):
            publisher.publish(T.Twist())
        assert trigger(stage, "stop")[0]
    assert stage.robot.status()["commands"] == before


def test_a_bridge_is_not_a_bus_of_motord_bus(stage):
    assert stage.robot.status()["bus"] is None
