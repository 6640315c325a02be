# SPDX-License-Identifier: Apache-2.0
"""`motord latency` on this machine: short runs of the real loop.

No test judges the measured times."""

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.sim.daemon_stage import wait_until

from motord.cli import cli
from motord.realtime.loop import Loop, LoopSettings
from motord.tools.latency.causes.switches import SwitchesUnknown, SwitchReader
from motord.tools.latency.load import BURNER
from motord.tools.latency.measure import LatencyError, LatencyOptions, run_latency
from motord.tools.latency.other_end import PEER
from motord.tools.latency.report import FIGURES
from motord.tools.latency.rig import core_config
from motord.tools.latency.trials import may_be_paused, paused, search

ROOT = Path(__file__).resolve().parents[3]
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{ROOT / 'daemon'}:{ROOT / 'hal'}:{ROOT}"}
COMMAND = [sys.executable, "-m", "motord", "latency"]
DEADLINE_S = 60.0
STOPPED_S = 0.2
SEARCHED_S = 0.3
"""Length of each measurement of a search: threads are sampled every tenth of a second."""


@pytest.fixture(scope="module")
def report():
    return run_latency(LatencyOptions(rate_hz=500.0, seconds=1.0))


def helpers():
    """Return the running processes that this one has started for a measurement."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent_pid = int(path.read_text().rsplit(")", 1)[1].split()[1])
            words = path.with_name("cmdline").read_bytes().decode(errors="replace").split("\0")
        except (FileNotFoundError, ProcessLookupError):
            continue
        if parent_pid == os.getpid() and {str(BURNER), str(PEER), "cyclictest"} & set(words):
            found.append((int(path.parent.name), words))
    return found


def left_behind():
    """Return the files of cyclictest processes that have ended."""
    files = Path("/dev/shm").glob("cyclictest*")
    return {f for f in files if not Path("/proc", f.name.removeprefix("cyclictest")).exists()}


def spreads(found):
    yield "lateness_us", found["lateness_us"]
    yield "step_ns", found["step_ns"]
    yield from found["handover_us"].items()
    if found["cyclictest_us"] is not None:
        yield "cyclictest_us", found["cyclictest_us"]


def test_the_report_has_the_keys_of_the_contract(report):
    found = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert {"rate_hz", "seconds", "policy", "ticks", "overruns", "cyclictest_us"} <= set(found)
    assert {"class", "load", "refusals", "machine"} <= set(found)
    assert set(found["handover_us"]) == {"command_to_core", "core_to_asyncio", "command_to_byte"}
    for name, spread in spreads(found):
        assert set(spread) == {"samples", *FIGURES}, name
    assert os.uname().nodename not in found["machine"].values()


def test_every_figure_is_measured_and_percentiles_are_in_order(report):
    for name, spread in spreads(report.to_json()):
        assert spread["samples"] > 0, name
        assert 0 < spread["p50"] <= spread["p99"] <= spread["p99_9"] <= spread["max"], name


def test_every_tick_is_in_every_total(report):
    assert report.ticks == report.lateness_us.samples == report.step_ns.samples
    assert report.ticks == sum(window.ticks for window in report.timeline)
    assert report.ticks == sum(bar.count for bar in report.histogram)
    assert report.overruns == sum(window.overruns for window in report.timeline)


def test_the_time_line_has_no_gap_and_its_worst_tick_is_the_worst_of_the_run(report):
    windows = report.timeline
    assert windows[0].start_s == 0.0
    assert all(a.end_s == b.start_s for a, b in itertools.pairwise(windows))
    assert windows[-1].end_s == report.seconds >= 1.0
    worst_us = max(window.lateness_max_us for window in windows)
    assert report.lateness_us.max <= worst_us <= report.lateness_us.max * 1.07


def test_bytes_on_the_wire_are_no_more_than_commands_in_the_core_or_sent(report):
    to_core, to_byte = (report.handover_us[k] for k in ("command_to_core", "command_to_byte"))
    assert to_byte.samples <= to_core.samples <= report.commands_sent
    assert to_byte.max > 0


def test_no_figure_of_the_report_is_constant(report):
    options = LatencyOptions(rate_hz=100.0, seconds=0.6, priority=0, cpu=(0,), load="gil")
    other = run_latency(options).to_json()
    found = report.to_json()
    keys = ["rate_hz", "seconds", "cpu", "load", "ticks", "lateness_us", "step_ns", "commands_sent"]
    if "scheduler" not in found["refusals"]:
        keys += ["policy", "priority"]
    if found["cyclictest_us"] is not None:
        keys += ["cyclictest_us", "cyclictest_note"]
    for key in keys:
        assert found[key] != other[key], key
    for name, spread in found["handover_us"].items():
        assert spread != other["handover_us"][name], name
    assert other["policy"] == "SCHED_OTHER"
    assert other["load"] == "gil"


@pytest.mark.parametrize("load", ["cpu", "io"])
def test_it_measures_under_load_and_leaves_nothing_behind(load):
    found = run_latency(LatencyOptions(rate_hz=500.0, seconds=0.4, load=load)).to_json()
    assert found["load"] == load
    assert all(spread["samples"] > 0 for _, spread in spreads(found))
    assert helpers() == []


@pytest.fixture(scope="module")
def recorded():
    """Skip a test where the kernel does not show its scheduler records."""
    try:
        SwitchReader([0]).__exit__()
    except SwitchesUnknown as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("recorded")
def test_the_kernels_records_name_forking_and_running_processes():
    begin_ns = time.monotonic_ns()
    with SwitchReader(range(os.cpu_count() or 1)) as reader:
        pids = []
        for _ in range(10):
            with subprocess.Popen(["true"]) as child:
                pids.append(child.pid)
        switches = reader.read(time.monotonic_ns())
    assert switches.forks[os.getpid()] >= len(pids)
    assert [switches.parent[pid] for pid in pids] == [os.getpid()] * len(pids)
    assert {switches.name[pid] for pid in pids} == {"true"}
    held = [switches.held(cpu, begin_ns, time.monotonic_ns()) for cpu in switches.on]
    assert all(any(pid in one for one in held) for pid in pids)


def searched(kind, **more):
    options = LatencyOptions(seconds=SEARCHED_S, cpu=(0,), load=kind)
    report = search(options, lambda _: None, lambda _: None, **more)
    return report if any(one.kind == KINDS[kind] for one in report.verdict.suspects) else None


KINDS = {"fork": "fork", "faults": "page faults"}


@pytest.mark.long
@pytest.mark.usefixtures("recorded")
@pytest.mark.parametrize("kind", KINDS)
def test_a_program_that_delays_the_loop_is_among_the_suspects(kind):
    report = wait_until(lambda: searched(kind, pause=True), f"{kind} is a suspect", 120.0)
    found = json.loads(json.dumps(report.to_json(), allow_nan=False))["late"]
    assert report.load == kind
    assert found["late_ticks"] > 0
    assert sum(found["stages"].values()) == found["late_ticks"]
    assert found["trials"][0]["name"] == "as it is"
    assert helpers() == []


@pytest.mark.usefixtures("recorded")
def test_a_paused_program_resumes_and_motords_own_are_never_paused():
    with subprocess.Popen(["sleep", "60"]) as child:
        state = Path(f"/proc/{child.pid}/stat")
        wait_until(lambda: may_be_paused(child.pid), "it has its command line")
        with pytest.raises(ZeroDivisionError), paused(child.pid):
            wait_until(lambda: state.read_text().split()[2] == "T", "stopped")
            raise ZeroDivisionError
        wait_until(lambda: state.read_text().split()[2] != "T", "goes on")
        child.kill()
    assert not any(may_be_paused(pid) for pid in (1, os.getpid(), os.getppid(), child.pid))
    with subprocess.Popen(["true"]) as ended:
        os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)
        assert not may_be_paused(ended.pid)
    with subprocess.Popen([*COMMAND, "--help"], stdout=subprocess.PIPE, env=ENVIRONMENT) as own:
        assert not may_be_paused(own.pid)
        own.communicate(timeout=DEADLINE_S)


def test_without_the_search_no_tick_is_recorded(report):
    assert report.verdict is None
    assert "late" not in report.to_json()


def test_progress_grows():
    seen = []
    run_latency(LatencyOptions(rate_hz=500.0, seconds=1.2), seen.append)
    assert len(seen) >= 2
    assert [p.elapsed_s for p in seen] == sorted(p.elapsed_s for p in seen)
    assert seen[-1].lateness.samples > seen[0].lateness.samples


def test_an_error_in_the_middle_leaves_nothing_behind():
    def fail(_):
        assert helpers()
        raise ZeroDivisionError

    before = left_behind()
    with pytest.raises(ZeroDivisionError):
        run_latency(LatencyOptions(rate_hz=500.0, seconds=5.0, load="cpu"), fail)
    assert helpers() == []
    assert left_behind() <= before
    with Loop(core_config(), LoopSettings(rate_hz=100.0, priority=0)) as loop:
        assert loop.status().running


def test_the_death_of_the_other_end_is_an_error_and_not_a_short_result():
    def kill_the_other_end(_):
        for pid, words in helpers():
            if str(PEER) in words:
                os.kill(pid, signal.SIGKILL)

    with pytest.raises(LatencyError, match="other end"):
        run_latency(LatencyOptions(rate_hz=500.0, seconds=0.5), kill_the_other_end)
    assert helpers() == []


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_a_duration_that_is_not_positive_and_finite_is_refused(seconds):
    with pytest.raises(ValueError, match="greater than zero"):
        run_latency(LatencyOptions(seconds=seconds))


def test_it_measures_outside_the_main_thread_too():
    found = []
    options = LatencyOptions(rate_hz=500.0, seconds=0.3)
    thread = threading.Thread(target=lambda: found.append(run_latency(options)))
    thread.start()
    thread.join(DEADLINE_S)
    assert found
    assert found[0].ticks > 0


@contextlib.contextmanager
def running():
    """Start a long run of the command; yield it once it measures."""
    with subprocess.Popen(
        [*COMMAND, "--seconds", "300", "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT, text=True,
    ) as process:  # fmt: skip
        try:
            assert any(" of 300: " in line for line in process.stderr)
            yield process
        finally:
            process.kill()


def ended(process):
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    return json.loads(out)


def test_ctrl_c_ends_it_early_with_what_was_measured():
    with running() as process:
        found = ended(process)
    assert found["ended_early"] is True
    assert found["seconds"] < 300.0
    assert found["ticks"] > 0


def was_stopped():
    with running() as process:
        process.send_signal(signal.SIGSTOP)
        time.sleep(STOPPED_S)
        process.send_signal(signal.SIGCONT)
        found = ended(process)
    assert found["overruns"] >= 0.9 * STOPPED_S * found["rate_hz"]
    return found


def test_a_stopped_process_is_rated_unusable():
    # A stop during a tick makes that tick long, but no wake-up late.
    found = wait_until(
        lambda: (run := was_stopped())["lateness_us"]["max"] >= 0.9 * STOPPED_S * 1e6 and run,
        "a stop while the loop sleeps",
    )
    assert found["class"]["name"] == "unusable"


def without_real_time():
    """Return a prefix of a command that takes the right to SCHED_FIFO away."""
    if os.geteuid() != 0:
        return ["prlimit", "--rtprio=0:0"]
    return ["setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice"]


@pytest.mark.skipif(shutil.which(without_real_time()[0]) is None, reason="no setpriv, no prlimit")
def test_a_refused_priority_is_warned_of_and_still_measured():
    done = subprocess.run(
        [*without_real_time(), *COMMAND, "--seconds", "0.3", "--json"],
        capture_output=True, text=True, timeout=DEADLINE_S, env=ENVIRONMENT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["policy"] == "SCHED_OTHER"
    assert "SCHED_FIFO priority 80 was refused" in found["refusals"]["scheduler"]
    assert "WARNING: SCHED_FIFO priority 80 was refused" in done.stderr
    assert found["cyclictest_us"] is None
    assert found["cyclictest_note"]


def test_the_command_prints_a_table_and_draws_a_picture(tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "run.png"
    result = CliRunner().invoke(
        cli, ["latency", "--seconds", "0.5", "--rate-hz", "500", "--plot", str(picture)]
    )
    assert result.exit_code == 0, result.output
    for word in ("lateness, µs", "step, ns", "command → core", "core → asyncio", "command → byte"):
        assert word in result.stdout
    assert result.stdout.splitlines()[-1].startswith("class: ")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_picture_that_cannot_be_written_does_not_lose_the_measurement(tmp_path):
    pytest.importorskip("matplotlib")
    folder = tmp_path / "taken.png"
    target = folder / "f.png"
    folder.mkdir()
    target.symlink_to(tmp_path / "nowhere" / "f.png")
    result = CliRunner().invoke(cli, ["latency", "--seconds", "0.3", "--plot", str(target)])
    assert result.exit_code == 1
    assert "lateness, µs" in result.stderr
    assert "--plot" in result.stderr
