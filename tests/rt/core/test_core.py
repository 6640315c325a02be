# SPDX-License-Identifier: Apache-2.0
"""core_step: the same input gives the same output. A replay of the core's journal relies on it."""

from _motord_rt import ffi
from hypothesis import given
from hypothesis import strategies as st
from tests.rt.core_rig import Rig, core_config

ANY = st.floats(allow_nan=True, allow_infinity=True)


def replay(twists: list[tuple[float, float]]) -> list[bytes]:
    rig = Rig(core_config(4))
    ffi.memmove(rig.out, b"\xaa" * ffi.sizeof("setpoints"), ffi.sizeof("setpoints"))
    ffi.memmove(rig.shown, b"\xaa" * ffi.sizeof("robot_state"), ffi.sizeof("robot_state"))
    rig.arm()
    record = []
    for linear_m_s, angular_rad_s in twists:
        rig.drive(linear_m_s, angular_rad_s)
        for _ in range(20):
            rig.tick()
            record.append(bytes(ffi.buffer(rig.out)) + bytes(ffi.buffer(rig.shown)))
    return record


@given(st.lists(st.tuples(ANY, ANY), min_size=1, max_size=5))
def test_the_same_input_gives_the_same_bytes_again(twists):
    assert replay(twists) == replay(twists)
