# SPDX-License-Identifier: Apache-2.0
"""The daemon: loop, lines, local socket, publishers and their watchers in one TaskGroup."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from motord.api.snapshot import Rest, rest_text
from motord.base.recent_log import RecentLog
from motord.base.sdnotify import Notifier
from motord.base.wall_clock import WallClock
from motord.bus.publish import KINDS, open_publisher
from motord.bus.publish.snapshot_feed import SnapshotFeed
from motord.config import Robot
from motord.control.assembly import core_config, line_specs, loop_settings
from motord.control.health import Health, Heart
from motord.control.machine import Event
from motord.control.operation import Operation
from motord.control.rate_watch import LineRate, RateWatch
from motord.control.source_log import SourceLog
from motord.daemon import procedures, running_file
from motord.daemon.battery_task import watch_battery
from motord.daemon.bus_supervisor import BusSupervisor
from motord.daemon.imu_task import watch_imu
from motord.daemon.methods import methods
from motord.daemon.safety_pins import open_guard
from motord.daemon.tracing import Tracing
from motord.local_socket.command_sockets import open_command_sockets, open_stop_socket
from motord.local_socket.server import listening, serve, socket_path
from motord.realtime.loop import Loop
from motord_hal.base.tasks import TaskGroup
from motord_hal.fieldbus.halt import nothing_answers
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import Line, LineState
from motord_hal.realtime.exchange import Exchange, now_ns

BEAT_MAX_S = 0.05
BEATS_PER_TIMEOUT = 5
HEALTH_PERIOD_S = 0.5
LOOP_WITHIN_S = 0.5
LINE_WITHIN_S = 2.0
LINE_WITHIN_CYCLES = 5

_log = logging.getLogger(__name__)


class _Over(Exception):
    """Exception that ends the group of tasks, which then cancels each of them once. If they were
    cancelled one by one, the group would do it again when one of them fails meanwhile, and cut off
    the end of a line."""


async def run(
    robot: Robot,
    path: Path | None = None,
    on_ready: Callable[[Path], None] = lambda _: None,
    *,
    starts_bus: bool = True,
) -> bool:
    """Run the daemon until a signal ends it: it starts disarmed, and brings the robot to rest and
    disarms it at the end. Return whether every drive is known to be without power, and the robot
    not in unknown motion.
    `on_ready` is called once, with the socket's path, when it listens. `starts_bus`: start
    motord-bus if the robot file needs it; False: another program does that.

    Raises ConfigRefused, ProfileError and LookupError if something is missing that the robot file
    requires, PageInUse and SocketInUse if such a daemon runs already, OSError for other
    failures."""
    profiles, notifier, health = robot.profiles, Notifier(), Health()
    specs = line_specs(robot, profiles)
    name, path = robot.robot.name, path or socket_path(robot.robot.name)
    ours = {key: section for key, section in robot.publish.items() if section.kind in KINDS}
    clock = WallClock()
    feeds = {key: SnapshotFeed(name, section.rate_hz, clock) for key, section in ours.items()}
    publishers = {key: open_publisher(key, section.kind, section) for key, section in ours.items()}
    bus = BusSupervisor(robot, path) if robot.has_bus and starts_bus else None
    with (
        _recent_log() as recent_log,
        _signals() as (end, force),
        listening(path) as listener,
        running_file.kept(robot, path.parent),
        open_command_sockets(robot, path) as command_sockets,
        open_stop_socket(robot, path) as stop_fd,
        open_guard(robot, {spec.name: spec.cycle_hz for spec in specs}) as guard,
        Loop(
            core_config(robot, profiles),
            loop_settings(robot, command_sockets.fds, guard, stop_fd),
            name,
            journal=robot.has_journal,
        ) as loop,
    ):
        operation = Operation(robot, loop, notifier)
        for spec in specs:
            operation.lines.append(open_line(spec, Exchange.of_loop(), operation.on_line_event))
        operation.take(Event.START)
        problems: list[str] = []
        try:
            async with TaskGroup() as tasks:
                for line in operation.lines:
                    tasks.create_task(line.run())
                tasks.create_task(_watch(operation, feeds))
                tasks.create_task(_beat(operation))
                tasks.create_task(procedures.disarm_on_request(operation))
                tasks.create_task(watch_battery(operation))
                tasks.create_task(watch_imu(operation))
                tasks.create_task(_watch_health(operation, health, notifier))
                for key, publisher in publishers.items():
                    tasks.create_task(publisher.run(feeds[key]))
                if bus is not None:
                    tasks.create_task(bus.run())
                tracing = Tracing(operation.lines)
                offered = methods(
                    operation, health, feeds, command_sockets, bus, recent_log, tracing
                )
                server = tasks.create_task(
                    serve(listener, offered, operation.disconnect, operation.leases.holds)
                )
                _say_hello(operation, path)
                notifier.ready()
                on_ready(path)
                await end.wait()
                problems = await _shut_down(operation, force, notifier, server)
                raise _Over
        except* _Over:
            pass
    return _say_how_it_ended(operation, problems)


def _power_unreported(operation: Operation) -> str:
    """Return which joints' power-off was only sent, because their board sends nothing; empty: all
    are known to be without power."""
    specs = [line.spec for line in operation.lines if nothing_answers(line.spec)]
    names = ", ".join(joint.name for spec in specs for joint in spec.joints)
    return names and f"the power-off of {names} was sent: nothing reports whether they have power"


def _say_how_it_ended(operation: Operation, problems: list[str]) -> bool:
    """Write the last line of the log. Return whether the end is a good one: see `run`."""
    unknown = operation.rest_unknown()
    if problems := [*problems, *operation.left_on]:
        text = f"ended, but not all drives are known to be without power: {problems[0]}"
        _log.warning("%s", "; ".join(filter(None, (text, unknown))))
    elif unknown:
        _log.warning("ended: disarmed; %s", unknown)
    elif operation.snapshot.rest == Rest.AT_REST:
        unmeasured, unreported = rest_text(**operation.rest_report()), _power_unreported(operation)
        doubts = "; ".join(filter(None, (unmeasured, unreported)))
        _log.info("ended: %s", f"disarmed; {doubts}" if doubts else "at rest and disarmed")
    else:
        _log.warning("ended: disarmed, without waiting for rest")
    return not (problems or unknown)


async def _shut_down(
    operation: Operation, force: asyncio.Event, notifier: Notifier, server: asyncio.Task[None]
) -> list[str]:
    """Stop answering the local socket, then shut the robot down (procedures.shut_down)."""
    _log.info("ending: the robot comes to rest first")
    notifier.stopping()
    server.cancel()
    await asyncio.wait([server])
    return await procedures.shut_down(operation, force)


@contextlib.contextmanager
def _recent_log() -> Iterator[RecentLog]:
    """Attach a log of the newest records to the root logger."""
    handler = RecentLog()
    logging.getLogger().addHandler(handler)
    try:
        yield handler
    finally:
        logging.getLogger().removeHandler(handler)


ENDING_SIGNALS = (
    *(signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
    # Ctrl-\ and Ctrl-Z: a daemon that is frozen or gone leaves the wheels to the drives
    *(signal.SIGQUIT, signal.SIGTSTP),
)
OTHER_SIGNALS = (
    *(signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF),
    *(signal.SIGIO, signal.SIGPWR, signal.SIGSTKFLT, signal.SIGXCPU),
    *range(signal.SIGRTMIN, signal.SIGRTMAX + 1),
)
"""Signals that nothing here sends, and that would kill the process by default (signal(7)). SIGABRT
and those of a fault of the program are not among them: they must end a process that hangs."""
TERMINAL_SIGNALS = (signal.SIGTTIN, signal.SIGTTOU)
"""Would freeze a daemon in the background that logs to its terminal; ignored, the output goes
there."""


@contextlib.contextmanager
def _signals() -> Iterator[tuple[asyncio.Event, asyncio.Event]]:
    """Yield two events: the first signal to end sets the first one, the next signal the second."""
    loop = asyncio.get_running_loop()
    end, force = asyncio.Event(), asyncio.Event()
    unused = [one for one in OTHER_SIGNALS if signal.getsignal(one) is signal.SIG_DFL]
    numbers = (*ENDING_SIGNALS, *unused)

    def asked(number: int) -> None:
        if number in unused:
            _log.warning("signal %s: the daemon ends", signal.strsignal(number))
        (force if end.is_set() else end).set()

    for number in numbers:
        loop.add_signal_handler(number, asked, number)
    for number in TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    try:
        yield end, force
    finally:
        for number in numbers:
            loop.remove_signal_handler(number)


def _say_hello(operation: Operation, path: Path) -> None:
    """Log once what runs, where it listens, and what the kernel did not grant."""
    status = operation.loop.status()
    _log.info(
        "%s: loop at %g Hz, %s, socket %s",
        operation.robot.robot.name,
        operation.robot.loop.rate_hz,
        status.policy,
        path,
    )
    for refusal in status.refusals.values():
        _log.warning("%s", refusal)


async def _watch(operation: Operation, feeds: Mapping[str, SnapshotFeed]) -> None:
    """Follow each new state of the loop: the machine first, the publishers after it."""
    woken = asyncio.Event()

    def wake() -> None:
        operation.loop.drain()
        woken.set()

    asyncio.get_running_loop().add_reader(operation.loop.fileno(), wake)
    try:
        while True:
            await woken.wait()
            woken.clear()
            operation.look()
            battery = operation.battery.report(now_ns()) if operation.battery else None
            for feed in feeds.values():
                feed.offer(operation.snapshot, battery)
    finally:
        asyncio.get_running_loop().remove_reader(operation.loop.fileno())


async def _beat(operation: Operation) -> None:
    """Send the heartbeat that the core watches: it stops when asyncio does."""
    timeout_s = operation.robot.safety.heartbeat_timeout_s
    while True:
        operation.beat()
        await asyncio.sleep(min(timeout_s / BEATS_PER_TIMEOUT, BEAT_MAX_S))


async def _watch_health(operation: Operation, health: Health, notifier: Notifier) -> None:
    """Feed the supervisor's watchdog as long as loop, lines and (by this very task) asyncio move.
    Log what the sources of commands do wrong."""
    period_s = min(HEALTH_PERIOD_S, (notifier.watchdog_s or 2.0) / 4.0)
    pin_errno, sources, rates = 0, SourceLog(operation.leases), RateWatch()
    while True:
        before, pin_errno = pin_errno, operation.loop.status().watchdog_errno
        if pin_errno not in (0, before):
            _log.warning("safety.watchdog: its pin: %s", os.strerror(pin_errno))
        verdict = health.judge(now_ns(), _hearts(operation))
        for message in verdict.messages:
            _log.warning("%s", message)
        if verdict.well:
            notifier.watchdog()
        else:
            operation.fault(f"stands still: {', '.join(verdict.stalled)}")
        sources.look()
        for message in rates.look(now_ns(), map(_line_rate, operation.lines)):
            _log.warning("%s", message)
        await asyncio.sleep(period_s)


def _line_rate(line: Line) -> LineRate:
    stats = line.stats()
    return LineRate(line=line.spec.name, cycle_hz=stats.cycle_hz, requested_hz=stats.requested_hz)


def _hearts(operation: Operation) -> list[Heart]:
    loop = Heart(name="the loop", count=operation.loop.status().ticks, within_s=LOOP_WITHIN_S)
    return [loop, *(_line_heart(line) for line in operation.lines)]


def _line_heart(line: Line) -> Heart:
    """Return the heart of a line. A line whose port is missing does not cycle, and is excused."""
    return Heart(
        name=f"line {line.spec.name}",
        count=line.stats().cycles,
        within_s=max(LINE_WITHIN_S, LINE_WITHIN_CYCLES / line.spec.cycle_hz),
        excused=line.state is LineState.CLOSED,
    )
