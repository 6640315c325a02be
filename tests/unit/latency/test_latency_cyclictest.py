# SPDX-License-Identifier: Apache-2.0
"""The output of cyclictest, and its command line."""

import asyncio
import shutil

import pytest

from motord.tools.latency.cyclictest import CyclictestError, beside, command, parse

DEADLINE_S = 30.0
RECORDED = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000001 000000
000002 000000
000003 000000
000004 000000
000005 000000
000006 000000
000007 000001
000008 000002
000009 000000
000010 000002
000011 000002
000012 000032
000013 000302
000014 000472
000015 000296
000016 000191
000017 000160
000018 000113
000019 000091
000020 000076
000021 000062
000022 000047
000023 000023
000024 000023
000025 000018
000026 000019
000027 000012
000028 000008
000029 000007
000030 000009
000031 000005
# Total: 000001973
# Min Latencies: 00007
# Avg Latencies: 00016
# Max Latencies: 00090
# Histogram Overflows: 00027
# Histogram Overflow at cycle number:
# Thread 0: 00002 00006 00017 00023 00026 00028 00029 00031 00034 00037 00038 00041

"""


def test_a_recorded_run_gives_its_percentiles():
    spread_us, histogram = parse(RECORDED)
    assert spread_us.samples == 1973 + 27
    assert spread_us.p50 == 15.0
    assert spread_us.max == 90.0
    assert [(bar.low_us, bar.high_us, bar.count) for bar in histogram][:2] == [(7, 8, 1), (8, 9, 2)]
    assert sum(bar.count for bar in histogram) == 1973


def test_a_percentile_among_the_overflows_is_reported_as_the_maximum():
    spread_us, _ = parse(RECORDED)
    assert spread_us.p99 == spread_us.p99_9 == 90.0
    none_over = RECORDED.replace("Overflows: 00027", "Overflows: 00000")
    assert parse(none_over)[0].p99 == 29.0


@pytest.mark.parametrize(
    "text",
    ["", "Unable to change scheduling policy!\n", RECORDED.split("# Max")[0],
     "000001 000000\n# Max Latencies: 00000\n# Histogram Overflows: 00000\n"],
)  # fmt: skip
def test_output_without_a_measurement_is_refused(text):
    with pytest.raises(CyclictestError):
        parse(text)


def test_cyclictest_runs_as_the_loop_does():
    line = command(rate_hz=4000.0, seconds=2.5, priority=80, cpu=(1, 3))
    assert {"-p80", "-a1,3", "-i250", "-D3"} <= set(line)


def test_priority_zero_requests_the_ordinary_scheduler():
    line = command(rate_hz=1000.0, seconds=1.0, priority=0, cpu=())
    assert "--policy=other" in line
    assert not [word for word in line if word.startswith(("-p", "-a"))]


async def test_a_missing_cyclictest_gives_a_note_and_no_figures(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    async with beside(1000.0, 60.0, 80, ()) as cyclictest:
        found = await cyclictest.result()
    assert found.spread_us is None
    assert "not installed" in found.note


REFUSING = """#!/bin/sh
trap '' INT
echo Unable to change scheduling policy! >&2
: > "$0.done"
exit 1
"""


async def test_a_refused_cyclictest_gives_its_own_error_as_the_note(monkeypatch, tmp_path):
    refusing = tmp_path / "cyclictest"
    refusing.write_text(REFUSING)
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    async with beside(1000.0, 60.0, 80, ()) as cyclictest, asyncio.timeout(DEADLINE_S):
        while not (tmp_path / "cyclictest.done").exists():
            await asyncio.sleep(0.01)
        found = await cyclictest.result()
    assert found.spread_us is None
    assert found.histogram == ()
    assert found.note == "cyclictest gave no result: Unable to change scheduling policy!"


@pytest.mark.skipif(shutil.which("cyclictest") is None, reason="cyclictest is not installed")
async def test_cyclictest_is_ended_early_with_what_it_counted():
    """A busy machine starts cyclictest late: the test waits longer until there is a count."""
    for after_s in (0.2, 1.0, 5.0):
        async with beside(1000.0, 600.0, 80, ()) as cyclictest:
            await asyncio.sleep(after_s)
            found = await cyclictest.result()
        if found.spread_us is not None:
            break
    else:
        pytest.skip(found.note)
    assert found.spread_us.samples > 0
    assert found.spread_us.p50 <= found.spread_us.p99 <= found.spread_us.p99_9
    assert found.note.startswith("cyclictest -q")
