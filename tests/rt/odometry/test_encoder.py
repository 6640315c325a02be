# SPDX-License-Identifier: Apache-2.0
"""Quadrature encoders: every edge counts once, in its direction, and the speed is that of the
edges."""

import math

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st

A, B = 17, 27
PER_COUNT = 2.0 * math.pi / 1320
MS = 1_000_000
START_NS = 1_000_000_000
GRAY = [(0, 0), (1, 0), (1, 1), (0, 1)]
"""Levels of (A, B), edge by edge, as the wheel turns forward."""


class Edges:
    """A wheel that makes edges, and the decoder that receives them; `position` is the truth."""

    def __init__(self, position: int = 0) -> None:
        self.position = position
        self.sequence = 0
        a, b = GRAY[position % 4]
        self.config = ffi.new(
            "encoder_config *",
            {
                "kind": lib.ENCODER_EDGES,
                "fd": 0,
                "a_offset": A,
                "b_offset": B,
                "levels": 2 * a + b,
                "rad_per_count": PER_COUNT,
            },
        )
        self.state = ffi.new("encoder_state *")
        lib.encoder_init(self.state, self.config)

    def step(self, direction: int, at_ns: int = START_NS) -> None:
        before = GRAY[self.position % 4]
        self.position += direction
        now = GRAY[self.position % 4]
        self.sequence += 1
        line, high = (A, now[0]) if before[0] != now[0] else (B, now[1])
        lib.encoder_edge(self.state, self.config, line, bool(high), self.sequence, at_ns)

    def velocity(self, at_ns: int) -> float:
        return lib.encoder_velocity_rad_s(self.state, self.config, at_ns)


@given(st.integers(0, 3), st.lists(st.sampled_from((-1, 1)), max_size=300))
def test_the_count_follows_every_path_of_edges(begin, path):
    wheel = Edges(begin)
    for direction in path:
        wheel.step(direction)
        assert wheel.state.count == wheel.position - begin
    assert (wheel.state.illegal, wheel.state.lost) == (0, 0)


@given(st.lists(st.tuples(st.sampled_from((A, B)), st.booleans()), max_size=200))
def test_no_event_counts_for_more_than_one_edge(events):
    wheel = Edges()
    for number, (line, high) in enumerate(events, 1):
        before = wheel.state.count
        lib.encoder_edge(wheel.state, wheel.config, line, high, number, START_NS)
        assert abs(wheel.state.count - before) <= 1
    assert wheel.state.illegal <= len(events)


CEILINGS = st.sampled_from([255, 999, 2**16 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1])


@given(CEILINGS, st.integers(0, 2**64 - 1), st.lists(st.integers(-(2**70), 2**70), max_size=30))
def test_a_counter_is_followed_across_its_wrap_in_both_directions(ceiling, begin, travels):
    config = ffi.new(
        "encoder_config *",
        {"kind": lib.ENCODER_COUNTER, "ceiling": ceiling, "rad_per_count": PER_COUNT},
    )
    state = ffi.new("encoder_state *")
    lib.encoder_init(state, config)
    modulo, position = ceiling + 1, begin % (ceiling + 1)
    first = position
    lib.encoder_counter(state, config, position, START_NS)
    for travel in travels:
        half = ceiling // 2
        position += travel % (2 * half) - half if half else 0
        lib.encoder_counter(state, config, position % modulo, START_NS)
        wrapped = (position - first + 2**63) % 2**64 - 2**63
        assert state.count == wrapped


@pytest.mark.parametrize("edges_per_s", [-20000.0, -300.0, -10.0, 7.0, 150.0, 3333.0, 100_000.0])
@pytest.mark.parametrize("look_every_ms", [1, 5])
def test_the_speed_is_that_of_the_edges_at_any_rate_of_looks(edges_per_s, look_every_ms):
    wheel, gap_ns = Edges(), round(1e9 / abs(edges_per_s))
    direction, edge_ns = (1 if edges_per_s > 0 else -1), START_NS
    seen, span_ms = [], min(1000.0, 2e7 / abs(edges_per_s))
    for look in range(1, round(span_ms) // look_every_ms):
        look_ns = START_NS + look * look_every_ms * MS
        while edge_ns + gap_ns <= look_ns:
            edge_ns += gap_ns
            wheel.step(direction, edge_ns)
        seen.append(wheel.velocity(look_ns))
    assert seen[-1] == pytest.approx(edges_per_s * PER_COUNT, rel=0.02)
    assert max(map(abs, seen)) < 1.02 * abs(edges_per_s) * PER_COUNT


@given(st.lists(st.tuples(st.integers(-(2**61), 2**61), st.sampled_from((-1, 1))), max_size=30))
def test_the_speed_is_finite_for_any_stamps(edges):
    wheel = Edges()
    for stamp_ns, direction in edges:
        wheel.step(direction, stamp_ns)
        assert math.isfinite(wheel.velocity(START_NS))
