# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 node that shares no code with motord, in its own process. Its types are written by hand,
and the DDS library encodes them.

    ros2_peer.py DOMAIN topic NAME TYPE [late]   a line of JSON for each sample
    ros2_peer.py DOMAIN drive NAME V W [AGE_S [NODE]]   20 TwistStamped a second; age "zero": the
                                                 stamp 0; NODE: the writer's node in the graph
    ros2_peer.py DOMAIN bursts NAME V N          N TwistStamped at once for each line on stdin;
                                                 for the line `old`, one that is a minute old
    ros2_peer.py DOMAIN frame NAME CHARS         20 TwistStamped a second, with a frame_id of CHARS
    ros2_peer.py DOMAIN plane NAME VX VY [plain]   20 TwistStamped a second, or Twist
    ros2_peer.py DOMAIN twist NAME V W [AHEAD_S] 20 Twist a second, with source timestamps AHEAD_S
                                                 ahead; after a line on stdin: 3 s less
    ros2_peer.py DOMAIN joints NAME JOINT=SPEED ... [AGE_S]   20 JointState a second
    ros2_peer.py DOMAIN say NAME TEXT [best [NODE]]  one String, repeatedly; best: best effort
    ros2_peer.py DOMAIN calls                    for each line on stdin, [NAME, TYPE, VALUES] in
                                                 JSON, one request; its reply as JSON
    ros2_peer.py DOMAIN act NAME TYPE [JSON]     one goal: accepted, feedback, result, each as JSON;
                                                 a line on standard input cancels the goal
    ros2_peer.py DOMAIN endpoints                a line of JSON for each endpoint that is seen
"""

import dataclasses
import json
import sys
import threading
import time
import uuid

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from tests.peers.ros2.ros2_peer_types import (
    ACTIONS,
    SERVICES,
    TOPICS,
    CancelReply,
    CancelRequest,
    Entities,
    Gid,
    GoalInfo,
    Header,
    JointState,
    NodeEntities,
    Parameter,
    ParameterValue,
    String,
    Time,
    Transition,
    Twist,
    TwistStamped,
    Uuid,
    Vector3,
)

LOCALHOST = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto"
    "</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers>"
    '<Peer address="localhost"/></Peers></Discovery></Domain></CycloneDDS>'
)
DEADLINE_S = 30.0
RELIABLE = (
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


_saying = threading.Lock()


def say(value):
    """Print a line of JSON. The lock keeps lines whole, because several threads print."""
    with _saying:
        print(json.dumps(value, default=list), flush=True)


def topic(participant, name, kind, late=""):
    durability = Policy.Durability.TransientLocal if late else Policy.Durability.Volatile
    reader = DataReader(
        participant, Topic(participant, name, TOPICS[kind]), Qos(*RELIABLE, durability)
    )
    while True:
        for sample in reader.take_iter(timeout=duration(seconds=DEADLINE_S)):
            say(dataclasses.asdict(sample))


_keep = []
"""DDS entities that have to live as long as this process: without a reference they end."""


def _in_the_graph(participant, node, writer):
    graph = DataWriter(
        participant,
        Topic(participant, "ros_discovery_info", Entities),
        Qos(*RELIABLE, Policy.Durability.TransientLocal),
    )
    written = [Gid(list(writer.guid.bytes))]
    graph.write(Entities(Gid(list(participant.guid.bytes)), [NodeEntities("/", node, [], written)]))
    return graph


def _publish(participant, name, kind, make, qos=RELIABLE, node=""):
    writer = DataWriter(participant, Topic(participant, name, kind), Qos(*qos))
    if node:
        _keep.append(_in_the_graph(participant, node, writer))
    while True:
        writer.write(make())
        time.sleep(0.05)


def _twist(linear_m_s, angular_rad_s, lateral_m_s=0.0):
    linear = Vector3(float(linear_m_s), float(lateral_m_s), 0.0)
    return Twist(linear, Vector3(0.0, 0.0, float(angular_rad_s)))


def plane(participant, name, linear_m_s, lateral_m_s, plain=""):
    def make():
        command = _twist(linear_m_s, 0.0, lateral_m_s)
        stamp = Time(*divmod(time.time_ns(), 1_000_000_000))
        return command if plain else TwistStamped(Header(stamp, ""), command)

    _publish(participant, name, Twist if plain else TwistStamped, make)


def twist(participant, name, linear_m_s, angular_rad_s, ahead_s="0"):
    writer = DataWriter(participant, Topic(participant, name, Twist), Qos(*RELIABLE))
    held, held_s = threading.Event(), 3.0
    threading.Thread(target=lambda: sys.stdin.readline() and held.set(), daemon=True).start()
    while True:
        late_s = held_s if held.is_set() else 0.0
        sent_ns = time.time_ns() + round((float(ahead_s) - late_s) * 1e9)
        writer.write(_twist(linear_m_s, angular_rad_s), timestamp=sent_ns)
        time.sleep(0.05)


def drive(participant, name, linear_m_s, angular_rad_s, age_s="0", node=""):
    def make():
        stamp_ns = 0 if age_s == "zero" else time.time_ns() - round(float(age_s) * 1e9)
        stamp = Time(*divmod(stamp_ns, 1_000_000_000))
        return TwistStamped(Header(stamp, ""), _twist(linear_m_s, angular_rad_s))

    _publish(participant, name, TwistStamped, make, node=node)


def _stamped(linear_m_s, frame="", age_s=0):
    stamp = Time(*divmod(time.time_ns() - age_s * 1_000_000_000, 1_000_000_000))
    return TwistStamped(Header(stamp, frame), _twist(linear_m_s, 0.0))


def bursts(participant, name, linear_m_s, count):
    writer = DataWriter(participant, Topic(participant, name, TwistStamped), Qos(*RELIABLE))
    while not writer.get_matched_subscriptions():
        time.sleep(0.01)
    say("received")
    for line in sys.stdin:
        if line.strip() == "old":
            writer.write(_stamped(linear_m_s, age_s=60))
            continue
        for _ in range(int(count)):
            writer.write(_stamped(linear_m_s))


def frame(participant, name, chars):
    _publish(participant, name, TwistStamped, lambda: _stamped(0.3, "x" * int(chars)))


def joints(participant, name, *words):
    speeds = dict(word.split("=") for word in words if "=" in word)
    (age_s,) = [word for word in words if "=" not in word] or ["0"]

    def make():
        stamp = Time(*divmod(time.time_ns() - round(float(age_s) * 1e9), 1_000_000_000))
        velocity = [float(speed) for speed in speeds.values()]
        return JointState(Header(stamp, ""), list(speeds), [], velocity, [])

    _publish(participant, name, JointState, make)


def _say_text(participant, name, text, best="", node=""):
    qos = (Policy.Reliability.BestEffort, *RELIABLE[1:]) if best else RELIABLE
    _publish(participant, name, String, lambda: String(text), qos, node)


def _built(kind, values):
    """Make a message of type `kind` from values in dictionaries and lists."""
    hints = {"parameters": Parameter, "value": ParameterValue, "transition": Transition}
    made = {}
    for key, value in values.items():
        inner = hints.get(key)
        if inner and isinstance(value, list):
            made[key] = [_built(inner, item) for item in value]
        else:
            made[key] = _built(inner, value) if inner else value
    return kind(**made)


def _service_id(endpoint):
    if endpoint is None:  # the endpoint has just ended
        return None
    data = [policy.data for policy in endpoint.qos if isinstance(policy, Policy.Userdata)]
    pairs = dict(pair.split(b"=") for pair in b"".join(data).split(b";") if pair)
    return pairs.get(b"serviceid")


class Caller:
    """A client of a service."""

    def __init__(self, participant, name, request, reply):
        mark = b"clientid=" + ".".join(f"{byte:x}" for byte in uuid.uuid4().bytes).encode() + b";"
        client = Policy.Userdata(mark)
        self._request = request
        self._reader = DataReader(
            participant, Topic(participant, f"rr{name}Reply", reply), Qos(*RELIABLE, client)
        )
        self._writer = DataWriter(
            participant, Topic(participant, f"rq{name}Request", request), Qos(*RELIABLE, client)
        )
        end_s = time.monotonic() + DEADLINE_S
        while not self._available():
            assert time.monotonic() < end_s, f"no server for {name}"
            time.sleep(0.01)
        self._guid = self._writer.instance_handle & 0xFFFFFFFFFFFFFFFF
        self._number = 0

    def _available(self):
        """Return whether a server is there: a reader and a writer with the same `serviceid`."""
        readers = map(
            self._writer.get_matched_subscription_data, self._writer.get_matched_subscriptions()
        )
        writers = map(
            self._reader.get_matched_publication_data, self._reader.get_matched_publications()
        )
        return {*map(_service_id, readers)} & {*map(_service_id, writers)} - {None}

    def ask(self, **values):
        self._number += 1
        asked = {"guid": self._guid, "seq": self._number, **values}
        self._writer.write(_built(self._request, asked))
        for sample in self._reader.take_iter(timeout=duration(seconds=DEADLINE_S)):
            if (sample.guid, sample.seq) == (self._guid, self._number):
                return sample
        raise AssertionError("no answer")


def calls(participant):
    callers = {}
    for line in sys.stdin:
        name, kind, values = json.loads(line)
        if name not in callers:
            callers[name] = Caller(participant, name, *SERVICES[kind])
        say(dataclasses.asdict(callers[name].ask(**values)))


def act(participant, name, kind, values="{}"):
    action, below = ACTIONS[kind], f"{name}/_action"
    feedback = DataReader(
        participant, Topic(participant, f"rt{below}/feedback", action.feedback), Qos(*RELIABLE)
    )
    cancel = Caller(participant, f"{below}/cancel_goal", CancelRequest, CancelReply)
    result = Caller(participant, f"{below}/get_result", action.ask, action.outcome)
    send = Caller(participant, f"{below}/send_goal", action.send, action.sent)
    goal_id = Uuid(list(uuid.uuid4().bytes))
    accepted = send.ask(goal_id=goal_id, goal=action.goal(**json.loads(values))).accepted
    say({"accepted": accepted})
    if not accepted:
        return

    def send_goals():
        for sample in feedback.take_iter(timeout=duration(seconds=DEADLINE_S)):
            if list(sample.goal_id.uuid) == list(goal_id.uuid):
                say({"feedback": dataclasses.asdict(sample.feedback)})

    def listen():
        if sys.stdin.readline():
            answer = cancel.ask(goal_info=GoalInfo(goal_id, Time(0, 0)))
            say({"canceling": len(answer.goals_canceling), "code": answer.return_code})

    for work in (send_goals, listen):
        threading.Thread(target=work, daemon=True).start()
    outcome = result.ask(goal_id=goal_id)
    say({"status": outcome.status, "result": dataclasses.asdict(outcome.result)})
    while True:  # until the test kills it; a thread still reads standard input
        time.sleep(1.0)


def endpoints(participant):
    readers = [
        BuiltinDataReader(participant, kind)
        for kind in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
    ]
    while True:
        for reader in readers:
            for found in reader.take(100):
                if found.sample_info.valid_data and found.participant_key != participant.guid:
                    data = [policy for policy in found.qos if isinstance(policy, Policy.Userdata)]
                    say(
                        {
                            "topic": found.topic_name,
                            "type": found.type_name,
                            "guid": list(found.key.bytes),
                            "user_data": data[0].data.decode() if data else "",
                        }
                    )
        time.sleep(0.05)


COMMANDS = {
    "topic": topic, "drive": drive, "plane": plane, "joints": joints, "twist": twist,
    "say": _say_text, "bursts": bursts, "frame": frame, "calls": calls, "act": act,
    "endpoints": endpoints,
}  # fmt: skip


def main():
    number, command, *words = sys.argv[1:]
    with_domain = Domain(int(number), LOCALHOST)
    COMMANDS[command](DomainParticipant(int(number)), *words)
    del with_domain  # kept until here: a domain ends with its last reference


if __name__ == "__main__":
    main()
