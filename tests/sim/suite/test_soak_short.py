# SPDX-License-Identifier: Apache-2.0
"""A short soak: the moving four-drive robot of tests/soak in a few batches of seeded faults of
every kind. The long soak is `make soak`."""

import re
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "soak"))

from fault_mix import SERIAL_KINDS, batches
from hurt_robot import PROFILE, limit_m_s, live
from reported import Reported

from motord.config.drives.load import load_profile

SEED = 20
FAULTS = 2 * len(SERIAL_KINDS)
BATCH = len(SERIAL_KINDS)
ENGINES = ("rt", "asyncio")


@pytest.fixture(scope="module")
def outcomes():
    """Outcomes of both engines, which run at once."""
    with ThreadPoolExecutor(len(ENGINES)) as pool:
        ran = pool.map(lambda engine: live(SEED, engine, FAULTS, BATCH), ENGINES)
        return dict(zip(ENGINES, ran, strict=True))


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_a_moving_robot_survives_every_kind_of_fault(outcomes, engine):
    outcome = outcomes[engine]
    assert outcome.violations == []
    assert outcome.faults.total() == FAULTS
    assert set(outcome.faults) == set(SERIAL_KINDS)
    assert outcome.checked_counts > FAULTS


def test_the_same_seed_gives_the_same_script():
    def script(seed):
        return list(batches(seed, 200, 20))

    assert script(5) == script(5) != script(6)
    often = Counter(kind for batch in script(5) for kind, _ in batch).values()
    assert max(often) - min(often) <= 1, "each kind as often as any other"


def test_long_delays_and_exceptions_of_code_zero_are_among_the_kinds():
    texts = dict(kind_and_text for batch in batches(5, 200, 20) for kind_and_text in batch)
    assert re.search(r"delay:.*ms=\d", texts["late-for-long"])
    assert "code=0" in texts["exception-code-0"].split(":")[1].split(",")


def test_the_limit_is_that_of_the_fastest_wheel_with_a_small_tolerance():
    most_m_s, tolerance_m_s = limit_m_s()
    assert most_m_s == pytest.approx(1.2)
    assert 0.0 < tolerance_m_s < 0.02 * most_m_s


class Journal:
    """Stand-in for the simulator: a journal of given counts."""

    def __init__(self, **entries):
        self.entries = {int(unit.removeprefix("unit_")): rows for unit, rows in entries.items()}

    def journal(self, line, unit, since):
        rows = self.entries.get(unit, [])[since : since + 1000]
        return [
            {"number": since + n, "monotonic_ns": at_ns, "address": address, "words": words}
            for n, (at_ns, address, words) in enumerate(rows)
        ]


@pytest.fixture
def reported(tmp_path):
    tap = tmp_path / "tap"
    tap.touch()
    return Reported("rs485", (1, 2), load_profile(PROFILE).registers["position"], tap)


MS = 1_000_000
AT = 0x20A5
WORDS = (0, 0, 0x0100, 0x0007, 0, 0)


@pytest.mark.parametrize(
    ("row", "wrong"),
    [
        pytest.param(f"0 {1000 * MS} {0x01000007} 0", 0, id="reported"),
        pytest.param(f"1 {1000 * MS} {0x01000007} 0", 1, id="reported by another drive"),
        pytest.param(f"0 {1000 * MS} {0x01000006} 0", 1, id="one bit off"),
        pytest.param(f"0 {900 * MS} {0x01000007} 0", 1, id="before it was reported"),
    ],
)
def test_only_a_count_that_the_drive_has_reported_passes(reported, row, wrong):
    reported.tap.write_text(row + "\n", encoding="ascii")
    reported.check(Journal(unit_1=[(1001 * MS, AT, WORDS), (1001 * MS, 0x2000, (0x0100, 0x0006))]))
    assert (reported.checked, len(reported.violations)) == (1, wrong)


def test_a_reply_to_an_older_request_is_counted_with_its_age(reported):
    reported.tap.write_text(f"0 {1300 * MS} {0x01000007} 0\n", encoding="ascii")
    reported.check(Journal(unit_1=[(1000 * MS, AT, WORDS)]))
    assert (reported.violations, reported.old, reported.oldest_s) == ([], 1, pytest.approx(0.3))
