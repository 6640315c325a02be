# SPDX-License-Identifier: Apache-2.0
"""Numbers of the senders that share the lease of one input."""

import re
from pathlib import Path

from motord.api.commands import SENDER_UNNAMED, SENDERS_NAMED
from motord.bus.commands.senders import KEPT_S, PLACES, UNKNOWN, Sender, Senders

ROOT = Path(__file__).parents[3]


def test_each_sender_keeps_a_number_of_its_own():
    senders = Senders()
    found = [senders.number(Sender(key=key), 0.0) for key in ("a", "b", "a", "c", "b")]
    assert found == [1, 2, 1, 3, 2]


def test_senders_without_a_key_share_a_number():
    assert Senders().number(UNKNOWN) == Senders().number(Sender("a name")) == SENDER_UNNAMED


def test_a_number_is_given_again_long_after_its_sender_s_newest_command():
    senders = Senders()
    for place, number in enumerate(PLACES):
        assert senders.number(Sender(key=place), float(place)) == number
    assert senders.number(Sender(key="more"), KEPT_S - 0.1) == SENDER_UNNAMED
    assert senders.number(Sender(key="more"), KEPT_S) == PLACES[0]
    assert senders.number(Sender(key=1), KEPT_S) == PLACES[1]


def test_the_receiver_in_c_has_other_numbers():
    header = (ROOT / "csrc/bus/bus.h").read_text(encoding="utf-8")
    first = int(re.search(r"OUTLET_SENDERS_FROM = (\d+)", header)[1])
    assert set(PLACES) == set(SENDERS_NAMED) & set(range(first))
