# SPDX-License-Identifier: Apache-2.0
"""The simulator's fault script: its grammar, and equal faults for an equal seed."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motord_hal.modbus.codec import (
    FrameError,
    Function,
    Request,
    build_exception,
    build_reply,
    parse_request,
    sealed,
)
from motord_hal.sim.fault_kinds import KINDS, FaultError, parse_fault
from motord_hal.sim.faults import FaultScript
from motord_hal.sim.rs485.framing import DdsmFraming, ModbusFraming
from motord_hal.sim.rs485.noise import disturb

READ = Request(1, Function.READ_HOLDING, 0x100, 3)
REPLY = build_reply(READ, (1, 2, 3))


def spoil(made, frame=REPLY, now_s=0.0):
    return made.spoil(frame[0], frame, ModbusFraming(), now_s)


def script(*texts, seed=1):
    made = FaultScript(seed)
    for text in texts:
        made.add(text)
    return made


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("dorp:p=0.1", "did you mean drop"),
        ("", 'no fault ""'),
        ("drop:q=1", 'no key "q"'),
        ("delay:mss=3", "did you mean ms"),
        ("drop:p=1.5", "not in 0 to 1"),
        ("drop:p=nan", "not in 0 to 1"),
        ("drop:from_s=inf", "not in 0 to"),
        ("drop:p=much", "expected a number"),
        ("drop:p", "p needs a value"),
        ("drop:nth=2.5", "not a whole number"),
        ("drop:p=0.5,nth=2", "either p or nth"),
        ("silence:from_s=2", "silence needs for_s"),
        ("fault:at_s=1", "either bit= or code="),
        ("fault:bit=1,code=1", "either bit= or code="),
    ],
)
def test_a_wrong_entry_is_refused_with_the_reason(text, says):
    with pytest.raises(FaultError) as caught:
        parse_fault(text)
    assert says in str(caught.value)
    assert f'"{text}"' in str(caught.value)


@settings(deadline=None)
@given(st.text(max_size=30) | st.from_regex(r"(drop|fault|delay):[a-z_]+=[-+0-9.enaif]*"))
def test_any_text_is_a_fault_or_a_fault_error(text):
    try:
        kind, values = parse_fault(text)
    except FaultError:
        return
    for name, value in values.items():
        assert KINDS[kind].keys[name].low <= value <= KINDS[kind].keys[name].high


def test_defaults_are_filled_in():
    assert parse_fault("delay") == ("delay", {"ms": 50.0})
    assert parse_fault("reboot: unit = 2") == ("reboot", {"at_s": 0.0, "for_s": 0.5, "unit": 2.0})


def test_nth_counts_the_replies_it_could_have_hit():
    made = script("drop:nth=3,unit=1")
    other = bytes([2]) + REPLY[1:]
    hits = [spoil(made, frame, 0.0).frame == b"" for frame in (REPLY, other, REPLY, REPLY) * 3]
    assert [place for place, hit in enumerate(hits) if hit] == [3, 7, 11]


def test_a_probability_comes_from_the_seed():
    def hits(seed):
        made = script("drop:p=0.3", seed=seed)
        return [spoil(made).frame == b"" for _ in range(200)]

    assert hits(1) == hits(1)
    assert hits(1) != hits(2)
    assert 20 < sum(hits(1)) < 100


def test_a_second_entry_does_not_change_what_the_first_one_does():
    alone = script("drop:p=0.3")
    both = script("drop:p=0.3", "delay:p=0.5")
    assert [spoil(alone).frame for _ in range(100)] == [spoil(both).frame for _ in range(100)]


def test_a_time_window_opens_and_closes():
    made = script("drop:from_s=2,for_s=1")
    dropped = [spoil(made, REPLY, now_s).frame == b"" for now_s in (1.9, 2.0, 2.9, 3.0)]
    assert dropped == [False, True, True, False]


def test_times_of_an_entry_count_from_when_it_was_added():
    made = FaultScript(1)
    made.add("reboot:at_s=3", now_s=10.0)
    assert not list(made.due(12.9))
    assert [fault.kind for fault in made.due(13.0)] == ["reboot"]
    assert not list(made.due(14.0))


def test_silence_affects_one_unit_and_ends():
    made = script("silence:unit=2,from_s=1,for_s=1")
    asked = [(2, 0.5), (2, 1.5), (1, 1.5), (2, 2.5)]
    assert [made.silent(unit, now_s) for unit, now_s in asked] == [False, True, False, False]


def test_a_cleared_script_does_nothing_more():
    made = script("drop")
    made.clear()
    assert spoil(made).frame == REPLY


def test_each_fault_changes_the_reply():
    torn = spoil(script("tear:after_bytes=4")).frame
    assert torn == REPLY[:4]
    corrupt = spoil(script("corrupt")).frame
    assert len(corrupt) == len(REPLY)
    assert not sealed(corrupt)
    glitch = spoil(script("glitch")).frame
    assert glitch == b"\x00" + REPLY
    foreign = spoil(script("wrong-unit")).frame
    assert sealed(foreign)
    assert foreign[0] != 1
    assert foreign[1:-2] == REPLY[1:-2]
    refused = spoil(script("exception:code=6")).frame
    assert refused == build_exception(1, 3, 6)
    assert spoil(script("late")).held
    delayed = spoil(script("delay:ms=40", "delay:ms=2"))
    assert (delayed.frame, delayed.delay_s) == (REPLY, pytest.approx(0.042))


def test_a_corrupt_frame_never_has_a_valid_check_sum():
    made = script("corrupt")
    for _ in range(300):
        with pytest.raises(FrameError):
            parse_request(spoil(made).frame)


def test_expired_faults_are_removed_when_one_is_added_and_stay_counted():
    made = script("drop:for_s=1", "drop:from_s=5,for_s=1", "reboot:at_s=1", "echo")
    spoil(made)
    assert [fault.kind for fault in made.due(2.0)] == ["reboot"]
    made.add("late", 2.0)
    assert [fault.text for fault in made.faults] == ["drop:from_s=5,for_s=1", "echo", "late"]
    assert made.past == {"drop": 1, "reboot": 1}
    made.clear()
    assert made.faults == []


def test_ten_thousand_short_faults_leave_a_short_script():
    made = FaultScript(1)
    for number in range(10_000):
        made.add("drop:for_s=0.5", float(number))
    assert len(made.faults) == 1


# -------------------------------------------------------------------------------------------- noise
@given(st.binary(max_size=40), st.integers(10, 12), st.integers())
def test_no_noise_changes_nothing(data, bits, seed):
    assert disturb(data, 0.0, bits, random.Random(seed)) == (data, 0)


@given(st.binary(max_size=40), st.floats(1e-6, 0.1), st.integers())
def test_noise_loses_characters_but_makes_none_and_its_seed_decides(data, ber, seed):
    received, hits = disturb(data, ber, 10, random.Random(seed))
    assert disturb(data, ber, 10, random.Random(seed)) == (received, hits)
    assert len(data) - hits <= len(received) <= len(data)
    if hits == 0:
        assert received == data


def test_noise_hits_as_many_bits_as_its_rate_gives():
    ber, bits, size = 0.01, 10, 40_000
    received, hits = disturb(bytes(size), ber, bits, random.Random(11))
    deviation = math.sqrt(size * bits * ber * (1.0 - ber))
    assert abs(hits - size * bits * ber) < 4.0 * deviation
    lost = size - len(received)
    start_or_stop = 1.0 - (1.0 - ber) ** (bits - 8)
    assert abs(lost - size * start_or_stop) < 4.0 * math.sqrt(size * start_or_stop)


@pytest.mark.parametrize("text", ["noise:ber=nan", "noise:ber=inf", "babble:hz=0", "wrong-baud"])
def test_invalid_noise_is_refused(text):
    with pytest.raises(FaultError):
        parse_fault(text)


@pytest.mark.parametrize("framing", [ModbusFraming(), DdsmFraming()])
@given(data=st.data())
def test_any_combination_of_faults_still_gives_bytes(framing, data):
    kinds = [kind for kind, what in KINDS.items() if what.happens == "reply"]
    specs = st.sampled_from([*kinds, *(f"tear:after_bytes={size}" for size in range(12))])
    made = script(*data.draw(st.lists(specs, max_size=6)))
    frame = REPLY if isinstance(framing, ModbusFraming) else bytes(10)
    assert isinstance(made.spoil(1, frame, framing, 0.0).frame, bytes)
