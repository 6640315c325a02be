# SPDX-License-Identifier: Apache-2.0
"""A daemon, its bridge node, and an operator's node that talks to the bridge. They run on rclpy
where it is installed (rclpy_real), and on a stand-in of its API elsewhere."""

import contextlib
import os
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import pytest
from tests.peers.ros2_rclpy.rclpy_real import ENVIRON, PYTHON, REAL
from tests.sim.daemon_stage import DEADLINE_S, ROOT, running, wait_until

STANDIN = Path(__file__).with_name("ros_standin")
if not REAL:
    sys.path.append(str(STANDIN))

import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

NAMESPACE = "/r2"
LEASE_S = 1.0
SETTINGS = (
    "input.ros.kind=ros2-rclpy", "input.ros.trust_network=true", f"input.ros.lease_s={LEASE_S}",
    "input.ros.priority=60", f"safety.command_timeout_s={LEASE_S}",
    "joint.left.tries=10", "joint.right.tries=10",
)  # fmt: skip
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ANSWERS = QoSProfile(depth=100)
"""Queue of the operator's clients. It is so long that only the bridge can lose a message."""
UNWARNED = pytest.mark.filterwarnings("ignore:Deprecated in favor of:DeprecationWarning")
"""Mark that ignores a warning: rclpy calls its own deprecated code if two QoS are incompatible."""
MODULE = ("-m", "motord.ros2_rclpy")


@contextlib.contextmanager
def ros(folder):
    """Set the environment in which the nodes discover each other."""
    domain = {
        "ROS_DOMAIN_ID": str(100 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder),
    }
    with contextlib.ExitStack() as cleanup:
        if REAL:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # its parser causes one
                import rosidl_generator_py  # noqa: F401
        else:
            import standin_wire

            path = folder / "hub.sock"
            cleanup.callback(standin_wire.forget)
            cleanup.enter_context(standin_wire.hub(path))
            domain = {standin_wire.HUB: str(path)}
        before = {key: os.environ.get(key) for key in domain}
        os.environ.update(domain)
        try:
            yield
        finally:
            for key, value in before.items():
                os.environ.pop(key)
                if value is not None:
                    os.environ[key] = value


class Bridge:
    """The process of the bridge, and its log."""

    def __init__(self, log, *words, ros_args=(), environ=None, program=MODULE, python=PYTHON):
        self.log = log
        path = [str(ROOT / "daemon"), str(ROOT / "hal"), *([] if REAL else [str(STANDIN)])]
        path += [os.environ["PYTHONPATH"]] if "PYTHONPATH" in os.environ else []
        self._sink = log.open("wb")
        self.process = subprocess.Popen(
            [python, *program, *map(str, words),
             "--ros-args", "-r", f"__ns:={NAMESPACE}", *map(str, ros_args)],
            stdin=subprocess.DEVNULL, stdout=self._sink, stderr=self._sink, cwd="/",
            env={**os.environ, **ENVIRON, "PYTHONPATH": os.pathsep.join(path), **(environ or {})},
        )  # fmt: skip

    def logged(self):
        return self.log.read_text(encoding="utf-8")

    def wait(self):
        return self.process.wait(DEADLINE_S)

    def close(self):
        self.process.kill()
        self.process.wait()
        self._sink.close()


@contextlib.contextmanager
def bridge(folder, *words, **options):
    made = Bridge(folder / f"bridge-{time.monotonic_ns()}.log", *words, **options)
    try:
        yield made
    finally:
        made.close()


class Operator:
    """A node in this process, with which a test does what an operator's programs do."""

    def __init__(self, name="operator"):
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self.node = Node(name, context=self._context, namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._spinning = threading.Thread(target=self._spin)
        self._spinning.start()
        self._clients, self._publishers = {}, {}

    def _spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self):
        rclpy.try_shutdown(context=self._context)
        self._spinning.join()
        self._executor.shutdown()
        self.node.destroy_node()

    def ask(self, name, kind, **values):
        """Call a service. Return the future of the answer."""
        key = (name, kind)
        if key not in self._clients:
            self._clients[key] = self.node.create_client(kind, name, qos_profile=ANSWERS)
        wait_until(self._clients[key].service_is_ready, f"a service {name}")
        return self._clients[key].call_async(kind.Request(**values))

    def call(self, name, kind, **values):
        return answered(self.ask(name, kind, **values), name)

    def publisher(self, name, kind, quality=10):
        """Return a publisher after it has found a subscriber."""
        key = (name, kind)
        if key not in self._publishers:
            self._publishers[key] = self.node.create_publisher(kind, name, quality)
        made = self._publishers[key]
        wait_until(lambda: made.get_subscription_count() > 0, f"a subscriber of {name}")
        return made

    def collect(self, name, kind, quality=10):
        """Subscribe to a topic. Return the list to which its messages are added."""
        received = []
        self.node.create_subscription(kind, name, received.append, quality)
        return received


def answered(future, what):
    wait_until(future.done, f"an answer of {what}")
    return future.result()


@contextlib.contextmanager
def operator(name="operator"):
    made = Operator(name)
    try:
        yield made
    finally:
        made.close()


@contextlib.contextmanager
def bridged(folder, *settings):
    """Run the daemon, the bridge and the operator's node."""
    with (
        ros(folder),
        running(folder, *SETTINGS, *settings) as stage,
        bridge(folder, "--socket", stage.socket) as stage.bridge,
        operator() as stage.operator,
    ):
        stage.wait_for("idle")
        stage.operator.call("motord/stop", Trigger)  # its answer shows that the bridge is ready
        yield stage
        assert "Traceback" not in stage.bridge.logged()


def again(stage, *settings):
    """Start the daemon once more, with the same arguments and further settings."""
    with stage.log.open("ab") as sink:
        return subprocess.Popen(
            [*stage.daemon.args, *(part for setting in settings for part in ("--set", setting))],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=sink, cwd=ROOT,
        )  # fmt: skip
