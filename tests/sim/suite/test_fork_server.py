# SPDX-License-Identifier: Apache-2.0
"""A program forked by the fork server is like one that exec has started."""

import contextlib
import importlib.util
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.fork_server import ABOVE, LATER, NAME_BYTES, started_from_nothing
from tests.sim.daemon_stage import wait_until
from tests.sim.pseudo_terminal import at_terminal

from motord.cli import COMMANDS

DEMO = str(Path(__file__).resolve().parents[3] / "config/robots/demo.toml")
DEADLINE_S = 60.0
SIMULATE = (sys.executable, "-m", "motord", "simulate", DEMO, "--stop-on-eof")


@contextlib.contextmanager
def simulator(**options):
    """Run a simulator; yield its process and its first line of output."""
    pipe = subprocess.PIPE
    with subprocess.Popen(SIMULATE, stdin=pipe, stdout=pipe, **options) as process:
        try:
            yield process, process.stdout.readline().decode()
        finally:
            process.kill()


def motord(*words, **options):
    command = [sys.executable, "-m", "motord", *words]
    done = subprocess.run(command, capture_output=True, timeout=DEADLINE_S, check=False, **options)
    return done.returncode, done.stdout, done.stderr


def of(process, name):
    return Path(f"/proc/{process.pid}/{name}")


def is_forked(process):
    """Return whether the command line is in the space that the fork server reserves for it."""
    return len(of(process, "cmdline").read_bytes()) > NAME_BYTES


def both(what, *arguments):
    """Return the result with a forked program, and with one started by exec."""
    with started_from_nothing():
        real = what(*arguments)
    return what(*arguments), real


def test_it_is_a_child_of_the_test_and_shows_its_own_command_line():
    with simulator() as (process, _):
        assert is_forked(process)
        fields = of(process, "stat").read_text(encoding="ascii").rpartition(")")[2].split()
        assert int(fields[1]) == os.getpid()
        words = of(process, "cmdline").read_text(encoding="utf-8").rstrip("\0").split("\0")
        assert tuple(words) == SIMULATE


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_as_it_ends_a_real_one(number):
    def status():
        with simulator() as (process, _):
            process.send_signal(number)
            return process.wait(DEADLINE_S)

    forked, real = both(status)
    assert forked == real


def test_the_end_of_its_standard_input_reaches_it():
    with simulator() as (process, _):
        process.stdin.close()
        assert process.wait(DEADLINE_S) == 0


@pytest.mark.parametrize(
    "words", [("check", DEMO), ("check", "nowhere.toml"), ("--version",), ("no-such-command",)]
)
def test_it_prints_and_ends_as_a_real_one(words):
    forked, real = both(motord, *words)
    assert forked == real


def test_it_runs_in_the_given_folder_and_environment(tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("own")  # a socket's path is short
    copy = tmp_path / "here.toml"
    copy.write_text(Path(DEMO).read_text(encoding="utf-8"), encoding="utf-8")
    assert motord("check", copy.name, cwd=tmp_path)[0] == 0
    with simulator(env={**os.environ, "TMPDIR": str(tmp_path)}) as (_, line):
        assert f"control socket {tmp_path}" in line


def test_it_has_the_descriptors_and_the_signals_of_a_real_one(tmp_path):
    def found():
        with (tmp_path / "not for it").open("wb"), simulator() as (process, _):
            status = of(process, "status").read_text(encoding="ascii").splitlines()
            masks = [row for row in status if row.startswith(("Sig", "Shd", "Cap", "NoNew"))]
            return {fd.name for fd in of(process, "fd").iterdir()}, masks

    forked, real = both(found)
    assert forked == real


def test_it_has_its_own_session_if_requested():
    with simulator(start_new_session=True) as (process, _):
        assert is_forked(process)
        assert os.getsid(process.pid) == process.pid


def test_it_controls_its_own_terminal_if_requested():
    def found():
        with at_terminal("simulate", DEMO, columns=200) as terminal:
            terminal.wait_for("control socket")
            process = terminal.process
            fields = of(process, "stat").read_text(encoding="ascii").rpartition(")")[2].split()
            group, session, number, foreground = map(int, fields[2:6])
            leads = {group, session, foreground} == {process.pid}
            terminal.type("\x03")
            return is_forked(process), leads, number > 0, terminal.exit_status()

    assert both(found) == ((True, True, True, 0), (False, True, True, 0))


def test_under_other_limits_it_is_started_by_exec():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft - 1, hard))
    try:
        with simulator() as (process, _):
            assert not is_forked(process)
            assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE)[0] == soft - 1
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_every_module_to_import_beforehand_exists():
    assert LATER.keys() <= COMMANDS.keys()
    for name in {name for names in LATER.values() for name in names}:
        assert importlib.util.find_spec(name) is not None, name


def children(pid):
    """Return the numbers of the child processes of this process."""
    return [
        number
        for path in Path(f"/proc/{pid}/task").glob("*/children")
        for number in path.read_text(encoding="ascii").split()
    ]


def test_the_daemon_of_a_demo_has_its_own_fork_server_and_none_of_the_demos_descriptors():
    def daemon():
        with contextlib.suppress(OSError):  # a process may end meanwhile
            for pid in children(demo.pid):
                tasks = Path(f"/proc/{pid}/task").glob("*/comm")
                if "motord-loop\n" in [path.read_text(encoding="ascii") for path in tasks]:
                    return pid  # all inherited descriptors are closed by then
        return None

    command = [sys.executable, "-m", "motord", "demo", "--seconds", "5"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as demo:
        try:
            pid = wait_until(daemon, "the loop of the demo's daemon")
            assert len(children(pid)) == 1
            assert all(int(path.name) < ABOVE for path in Path(f"/proc/{pid}/fd").iterdir())
        finally:
            demo.send_signal(signal.SIGINT)
